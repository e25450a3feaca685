import socket

import pytest

from hm_driver.device.link import CommandLink
from hm_driver.errors import ProtocolError, TransportClosed, TransportTimeout
from hm_driver.protocol.framing import Dialect
from hm_driver.transport.tcp import TcpTransport


class Pieces:
    """A transport that hands out prepared pieces of replies."""

    url = "pieces:"

    def __init__(self, *pieces):
        self.pieces = list(pieces)
        self.sent = []
        self.waits = []
        self.is_closed = False

    def send(self, data):
        self.sent.append(data)

    def receive(self, timeout_s):
        self.waits.append(timeout_s)
        piece = self.pieces.pop(0) if self.pieces else None
        if piece is None:
            raise TransportTimeout(f"no byte within {timeout_s} s")
        return piece

    def close(self):
        self.is_closed = True


def test_a_line_goes_out_and_comes_back_as_it_stands_on_the_wire():
    transport = Pieces(b"stop;\n")
    assert CommandLink(transport, Dialect.TEXT).exchange_line(b"get state\n") == b"stop;\n"
    assert transport.sent == [b"get state\n"]


def test_a_line_that_comes_in_pieces_is_joined():
    assert CommandLink(Pieces(b"st", b"op", b";\n"), Dialect.TEXT).exchange_line(b"get state\n") == b"stop;\n"


def test_a_line_that_does_not_end_breaks_the_link():
    link = CommandLink(Pieces(b"st"), Dialect.TEXT)
    with pytest.raises(TransportTimeout):
        link.exchange_line(b"get state\n")
    assert link.is_broken
    with pytest.raises(TransportClosed):
        link.exchange_line(b"get state\n")


def test_a_stall_of_the_machine_takes_a_part_of_the_patience_alone():
    transport = Pieces(None, None, b"stop;\n")
    assert CommandLink(transport, Dialect.TEXT, timeout_s=0.05).exchange_line(b"get state\n") == b"stop;\n"
    silent = Pieces()
    with pytest.raises(TransportTimeout, match=r"0\.05 s"):
        CommandLink(silent, Dialect.TEXT, timeout_s=0.05).exchange_line(b"get state\n")
    assert silent.waits == pytest.approx([0.01] * 5)


def test_two_lines_to_one_request_break_the_link():
    link = CommandLink(Pieces(b"stop;\nstop;\n"), Dialect.TEXT)
    with pytest.raises(ProtocolError, match="more than one"):
        link.exchange_line(b"get state\n")
    assert link.is_broken


def test_what_goes_on_while_the_device_answers_stands_between_the_halves_of_an_exchange():
    transport = Pieces(b"stop;\n")
    link = CommandLink(transport, Dialect.TEXT)
    link.send_line(b"get state\n")
    assert (transport.sent, transport.waits) == ([b"get state\n"], [])
    assert link.receive_line() == b"stop;\n"


def test_an_answer_that_nobody_fetched_is_not_taken_for_that_of_the_next_command():
    transport = Pieces(b"[0,0,0];\n", b"state set to 'stop';\n")
    link = CommandLink(transport, Dialect.TEXT)
    link.send_line(b"get measpos\n")
    assert link.exchange("set state stop") == "state set to 'stop';"
    assert transport.sent == [b"get measpos\n", b"set state stop\n"]


@pytest.fixture
def pair():
    ours, theirs = socket.socketpair()
    link = CommandLink(TcpTransport(ours, url="tcp://pair"), Dialect.TEXT, timeout_s=0.05)
    yield link, theirs
    link.close()
    theirs.close()


def test_a_line_goes_over_a_socket_and_back(pair):
    link, peer = pair
    peer.sendall(b"stop;\n")
    assert link.exchange_line(b"get state\n") == b"stop;\n"
    assert peer.recv(100) == b"get state\n"


def test_a_peer_that_says_nothing_is_waited_for_as_long_as_the_link_allows(pair):
    link, _ = pair
    with pytest.raises(TransportTimeout, match=r"0\.05 s"):
        link.exchange_line(b"get state\n")
    assert link.is_broken


@pytest.mark.parametrize("is_reset", [False, True])
def test_a_peer_that_hangs_up_breaks_the_link(pair, is_reset):
    link, peer = pair
    link.send_line(b"get state\n")
    if not is_reset:
        peer.recv(100)
    peer.close()
    with pytest.raises(TransportClosed):
        link.receive_line()
    with pytest.raises(TransportClosed):
        link.send_line(b"get state\n")


def test_a_line_to_a_peer_that_is_gone_breaks_the_link(pair):
    link, peer = pair
    peer.close()
    with pytest.raises(TransportClosed, match="connection lost"):
        link.send_line(b"get state\n")
    assert link.is_broken


def test_another_time_out_counts_from_the_next_line_on(pair):
    link, peer = pair
    peer.sendall(b"stop;\n")
    link.exchange_line(b"get state\n")
    link.timeout_s = 0.01
    with pytest.raises(TransportTimeout, match=r"0\.01 s"):
        link.exchange_line(b"get state\n")
