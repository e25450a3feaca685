import socket
import threading
import time

import pytest

from hm_driver.device.link import CommandLink, connect_link
from hm_driver.errors import (
    ConfigurationError,
    DeviceError,
    ProtocolError,
    TransportClosed,
    TransportError,
    TransportTimeout,
)
from hm_driver.protocol.framing import Dialect, RequestDecoder, encode_reply
from hm_driver.transport.in_process import InProcessTransport


class Peer:
    """Answers each request by the next bytes of a script, and keeps what it was asked."""

    def __init__(self, *answers):
        self.answers = list(answers)
        self.asked = []

    def handle(self, data):
        self.asked.append(data)
        return self.answers.pop(0)


def link_to(*answers, dialect=Dialect.TEXT, **options):
    peer = Peer(*answers)
    return CommandLink(InProcessTransport(peer), dialect, **options), peer


def test_a_text_exchange_sends_a_line_and_returns_the_reply_as_it_came():
    link, peer = link_to(b"stop;\n")
    assert link.exchange("get state") == "stop;"
    assert peer.asked == [b"get state\n"]


def test_a_framed_exchange_sends_a_frame():
    link, peer = link_to(b'\0\0\0\6\0\0\0\0"stop"', dialect=Dialect.FRAMED)
    assert link.ask("get state") == '"stop"'
    assert peer.asked == [b"\0\0\0\x09\0\0\0\0get state"]


def test_an_error_reply_is_an_exception_and_the_link_goes_on():
    link, _ = link_to(b"--- ERROR: no;\n", b"stop;\n")
    with pytest.raises(DeviceError) as caught:
        link.ask("get x")
    assert (caught.value.command, caught.value.reply) == ("get x", "--- ERROR: no")
    assert link.ask("get state") == "stop"


def test_the_refused_one_of_several_commands_is_named():
    link, _ = link_to(b"stop;--- ERROR: no;2;\n")
    with pytest.raises(DeviceError) as caught:
        link.exchange_joined("get state; get x; get inertia", 3)
    assert (caught.value.command, caught.value.reply) == ("get x", "--- ERROR: no")


@pytest.mark.parametrize(
    ("answer", "kind", "received"),
    [
        (b"", TransportTimeout, ""),
        (b"sto", TransportTimeout, "b'sto'"),
        (b"stop", TransportTimeout, "b'stop'"),
        (b"stop;\nstop;\n", ProtocolError, "stop;;stop;"),
        (b"stop\n", ProtocolError, "stop"),
        (b"1;2;\n", ProtocolError, "1;2"),
    ],
)
def test_an_exchange_that_fails_carries_its_command_and_what_came(answer, kind, received):
    link, _ = link_to(answer)
    with pytest.raises(kind, match="'get state'") as caught:
        link.ask("get state")
    assert (caught.value.command, caught.value.received) == ("get state", received)
    assert caught.value.reply == received


def test_a_line_of_the_loop_that_is_not_answered_is_named():
    link, _ = link_to(b"", timeout_s=0.01)
    with pytest.raises(TransportTimeout, match="'get measpos; get state'") as caught:
        link.exchange_line(b"get measpos; get state\n")
    assert caught.value.command == "get measpos; get state"
    with pytest.raises(TransportClosed) as caught:
        link.exchange("get os")
    assert caught.value.command == "get os"


def test_a_wrong_number_of_parts_is_refused():
    link, _ = link_to(b"stop;2;\n")
    with pytest.raises(ProtocolError, match="2 parts instead of 3"):
        link.exchange_joined("get state; get inertia; get os", 3)


def test_several_commands_go_one_by_one_until_the_device_is_known_to_combine():
    link, peer = link_to(b"stop;\n", b"2;\n", b"stop;2;\n")
    assert link.exchange_many(["get state", "get inertia"]) == ["stop", "2"]
    link.combined = True
    assert link.exchange_many(["get state", "get inertia"]) == ["stop", "2"]
    assert peer.asked[2] == b"get state; get inertia\n"


def test_nothing_to_exchange_sends_nothing():
    link, peer = link_to()
    link.combined = True
    assert link.exchange_many([]) == []
    assert peer.asked == []


def test_many_commands_are_spread_over_requests_of_bounded_length():
    count = 100

    class Device:
        longest = 0

        def handle(self, data):
            self.longest = max(self.longest, len(data))
            return b"ok;" * (data.count(b";") + 1) + b"\n"

    device = Device()
    link = CommandLink(InProcessTransport(device), Dialect.TEXT)
    link.combined = True
    assert link.exchange_many(["set spring_z stiffness 500"] * count) == ["ok"] * count
    assert device.longest <= 1001


def test_after_a_timeout_a_late_reply_is_never_taken_for_the_next_ones():
    link, peer = link_to(b"", b"late;\nstop;\n")
    with pytest.raises(TransportTimeout):
        link.ask("get inertia")
    assert link.is_broken
    with pytest.raises(TransportClosed, match="reconnect"):
        link.ask("get state")
    assert len(peer.asked) == 1


def test_half_a_reply_is_a_timeout():
    link, _ = link_to(b"sto")
    with pytest.raises(TransportTimeout):
        link.ask("get state")
    assert link.is_broken


@pytest.mark.parametrize("answer", [b"stop;\nstop;\n", b"stop;\nst", b"caf\xe9;\n"])
def test_what_is_not_one_reply_breaks_the_link(answer):
    link, _ = link_to(answer)
    with pytest.raises(ProtocolError):
        link.ask("get state")
    with pytest.raises(TransportClosed):
        link.ask("get state")


def test_an_interrupted_exchange_breaks_the_link():
    class Interrupted:
        def handle(self, _data):
            raise KeyboardInterrupt

    link = CommandLink(InProcessTransport(Interrupted()), Dialect.TEXT)
    with pytest.raises(KeyboardInterrupt):
        link.ask("get state")
    assert link.is_broken


def test_closing_twice_does_nothing_more():
    link, _ = link_to()
    link.close()
    link.close()
    with pytest.raises(TransportClosed, match="it was closed"):
        link.ask("get state")


def test_a_link_reconnects_when_asked():
    answers = [Peer(b""), Peer(b"stop;\n")]
    link = CommandLink(
        InProcessTransport(answers.pop(0)),
        Dialect.TEXT,
        reopen=lambda: InProcessTransport(answers.pop(0)),
    )
    with pytest.raises(TransportTimeout):
        link.ask("get state")
    link.reconnect()
    assert link.ask("get state") == "stop"


def test_a_link_that_cannot_be_opened_anew_says_so():
    link, _ = link_to()
    with pytest.raises(TransportError, match="make another one"):
        link.reconnect()


def test_a_device_that_combines_is_recognised_by_a_harmless_set():
    link, peer = link_to(b"3;\n", b"3;Inertia set;stop;\n")
    assert link.probe_combined()
    assert link.combined
    assert peer.asked == [b"get inertia\n", b"get inertia; set inertia 3; get state\n"]


@pytest.mark.parametrize(
    "answer", [b"3;\n", b"--- ERROR: syntax;\n", b"3;--- ERROR: no;stop;\n", b"x;y;z;\n"]
)
def test_a_device_that_does_not_combine_gets_one_command_at_a_time(answer):
    link, _ = link_to(b"3;\n", answer)
    assert not link.probe_combined()
    assert not link.combined


@pytest.mark.parametrize("answer", [b"3;\nInertia set;\nstop;\n", b""])
def test_after_an_odd_answer_to_several_commands_the_link_starts_afresh(answer):
    link, _ = link_to(b"3;\n", answer, reopen=lambda: InProcessTransport(Peer(b"stop;\n")))
    assert not link.probe_combined()
    assert link.ask("get state") == "stop"


def test_a_framed_device_is_not_asked_to_combine():
    link, peer = link_to(dialect=Dialect.FRAMED)
    assert not link.probe_combined()
    assert peer.asked == []


class Listener:
    """A server on a free port that gives each connection to `serve`."""

    def __init__(self, serve):
        self._serve = serve
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = self._socket.getsockname()[1]
        self.url = f"tcp://127.0.0.1:{self.port}"
        self.connections = 0
        self._thread = threading.Thread(target=self._run)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        self._thread.join()

    def _run(self):
        while True:
            try:
                connection, _ = self._socket.accept()
            except OSError:
                return
            self.connections += 1
            with connection:
                self._serve(connection)


def device_speaking(*dialects):
    def serve(connection):
        decoder = RequestDecoder()
        while data := connection.recv(4096):
            for _ in decoder.feed(data):
                if decoder.dialect in dialects:
                    part = '"stop"' if decoder.dialect is Dialect.FRAMED else "stop"
                    connection.sendall(encode_reply(decoder.dialect, [part]))

    return serve


def garbage(connection):
    connection.recv(4096)
    connection.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")


def echo(connection):
    while data := connection.recv(4096):
        connection.sendall(data)


def silence(connection):
    while connection.recv(4096):
        pass


def test_a_text_device_is_found_on_the_first_connection():
    with Listener(device_speaking(Dialect.TEXT, Dialect.FRAMED)) as listener:
        link = connect_link(listener.url)
        assert (link.dialect, listener.connections) == (Dialect.TEXT, 1)
        link.close()


def test_a_framed_device_is_found_on_a_fresh_connection():
    with Listener(device_speaking(Dialect.FRAMED)) as listener:
        link = connect_link(listener.url)
        assert (link.dialect, listener.connections) == (Dialect.FRAMED, 2)
        link.close()


def test_a_dialect_that_is_named_is_the_only_one_tried():
    with Listener(device_speaking(Dialect.TEXT, Dialect.FRAMED)) as listener:
        link = connect_link(f"{listener.url}?dialect=framed")
        assert (link.dialect, listener.connections) == (Dialect.FRAMED, 1)
        link.close()


def test_what_was_found_is_logged(caplog):
    with Listener(device_speaking(Dialect.TEXT)) as listener, caplog.at_level("INFO"):
        connect_link(listener.url).close()
    assert "speaks the text dialect" in caplog.text


@pytest.mark.parametrize("serve", [garbage, echo, silence, lambda _: None])
def test_a_listener_that_is_no_hapticmaster_is_refused_with_what_was_tried(serve):
    with (
        Listener(serve) as listener,
        pytest.raises(
            ProtocolError,
            match=rf"127\.0\.0\.1:{listener.port} is no HapticMASTER.*text: .*framed: .*dialect=",
        ),
    ):
        connect_link(listener.url)


def test_a_port_where_nothing_listens_is_an_error_of_the_link():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(TransportError, match=f"127.0.0.1:{port}"):
        connect_link(f"tcp://127.0.0.1:{port}")


def test_an_unknown_dialect_is_refused():
    with pytest.raises(ConfigurationError, match="auto, text, framed"):
        connect_link("tcp://127.0.0.1?dialect=morse")


def test_close_from_another_thread_ends_a_waiting_exchange():
    with Listener(device_speaking(Dialect.TEXT)) as listener:
        link = connect_link(listener.url)
        link.dialect = Dialect.FRAMED  # which this device never answers
        closer = threading.Timer(0.05, link.close)
        closer.start()
        started = time.monotonic()
        with pytest.raises(TransportClosed):
            link.exchange("get state", timeout_s=10.0)
        closer.join()
        assert time.monotonic() - started < 5.0
