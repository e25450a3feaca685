"""The contract suite: subclass `TransportContract` with a `make_link` fixture to hold a transport to it.

`make_link(answer)` returns an open transport whose peer calls `answer(data)` for what it gets and writes each
item of the list that it returns by itself; the item None closes the peer's end.
"""

import threading
import time

import pytest

from hm_driver.errors import TransportClosed, TransportTimeout

WAIT_S = 2.0


def echo(data):
    return [data]


def say_nothing(_data):
    return []


def hang_up(_data):
    return [None]


def talk(link, data, times):
    for _ in range(times):
        link.send(data)
        link.receive(WAIT_S)


def flood(link, data, times):
    for _ in range(times):
        link.send(data)


def receive_all(link, count):
    received = b""
    while len(received) < count:
        received += link.receive(WAIT_S)
    return received


class TransportContract:
    is_live = True  # whether the peer runs beside the caller, so that waiting makes sense

    def test_what_is_sent_comes_back_from_an_echo(self, make_link):
        link = make_link(echo)
        link.send(b"get state\n")
        assert receive_all(link, 10) == b"get state\n"

    def test_every_byte_value_goes_through_unchanged(self, make_link):
        link = make_link(echo)
        data = bytes(range(256)) * 40
        link.send(data)
        assert receive_all(link, len(data)) == data

    def test_a_reply_in_pieces_arrives_whole_and_in_order(self, make_link):
        link = make_link(lambda data: [data[:3], data[3:4], data[4:]])
        link.send(b"abcdefgh")
        assert receive_all(link, 8) == b"abcdefgh"

    def test_receive_never_returns_an_empty_message(self, make_link):
        link = make_link(lambda data: [b"", data])
        link.send(b"x")
        assert link.receive(WAIT_S) == b"x"

    def test_silence_ends_in_a_timeout_that_names_the_link_and_the_limit(self, make_link):
        link = make_link(say_nothing)
        link.send(b"x")
        with pytest.raises(TransportTimeout, match=r"0\.05 s") as caught:
            link.receive(0.05)
        assert link.url in str(caught.value)

    def test_a_timeout_lasts_as_long_as_asked(self, make_link):
        link = make_link(say_nothing)
        started = time.monotonic()
        with pytest.raises(TransportTimeout):
            link.receive(0.05)
        elapsed = time.monotonic() - started
        assert elapsed < WAIT_S
        assert elapsed >= 0.049 or not self.is_live

    def test_a_timeout_of_zero_does_not_wait(self, make_link):
        link = make_link(say_nothing)
        started = time.monotonic()
        with pytest.raises(TransportTimeout):
            link.receive(0.0)
        assert time.monotonic() - started < 0.5

    def test_the_link_works_on_after_a_receive_timed_out(self, make_link):
        link = make_link(echo)
        with pytest.raises(TransportTimeout):
            link.receive(0.01)
        link.send(b"later")
        assert receive_all(link, 5) == b"later"

    def test_a_peer_that_hangs_up_is_reported_as_closed(self, make_link):
        link = make_link(hang_up)
        with pytest.raises(TransportClosed):
            talk(link, b"x", times=100)

    def test_a_closed_link_refuses_to_send_and_to_receive(self, make_link):
        link = make_link(echo)
        link.close()
        with pytest.raises(TransportClosed):
            link.send(b"x")
        with pytest.raises(TransportClosed):
            link.receive(0.1)

    def test_closing_twice_does_nothing_more(self, make_link):
        link = make_link(echo)
        link.close()
        link.close()

    def test_close_from_another_thread_wakes_the_one_that_waits(self, make_link):
        if not self.is_live:
            pytest.skip("nobody can wait on a peer in the same thread")
        link = make_link(say_nothing)
        closer = threading.Timer(0.05, link.close)
        closer.start()
        started = time.monotonic()
        with pytest.raises(TransportClosed):
            link.receive(10.0)
        closer.join()
        assert time.monotonic() - started < 5.0

    def test_a_peer_that_takes_nothing_ends_in_a_timeout_and_a_closed_link(self, make_link):
        if not self.is_live:
            pytest.skip("a peer in the same thread takes everything")
        link = make_link(None, timeout_s=0.1)
        started = time.monotonic()
        with pytest.raises(TransportTimeout):
            flood(link, bytes(1_000_000), times=1000)
        assert time.monotonic() - started < 10.0
        with pytest.raises(TransportClosed):
            link.send(b"x")

    def test_statistics_count_messages_bytes_and_errors(self, make_link):
        link = make_link(echo)
        link.send(b"abc")
        assert receive_all(link, 3) == b"abc"
        with pytest.raises(TransportTimeout):
            link.receive(0.01)
        counted = link.statistics
        assert (counted.sent_messages, counted.sent_bytes, counted.received_bytes) == (1, 3, 3)
        assert counted.received_messages >= 1
        assert counted.errors == 1

    def test_statistics_time_the_round_trips(self, make_link):
        link = make_link(lambda data: [data] if data != b"mute" else [])
        before = time.monotonic()
        talk(link, b"abc", times=3)
        link.send(b"mute")
        counted = link.statistics
        assert counted.round_trips == 3
        assert 0.0 < counted.last_round_trip_s <= counted.longest_round_trip_s < time.monotonic() - before
        assert 0.0 < counted.mean_round_trip_s <= counted.longest_round_trip_s
