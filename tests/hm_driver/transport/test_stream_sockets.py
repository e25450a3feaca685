import socket
import threading

import pytest
from transport_contract import TransportContract

from hm_driver.errors import ConfigurationError, TransportError, TransportTimeout
from hm_driver.transport.urls import open_transport


def serve(listener, answer, stop):
    connection, _ = listener.accept()
    with connection:
        if answer is None:
            stop.wait(20.0)
            return
        while data := connection.recv(65536):
            for piece in answer(data):
                if piece is None:
                    return
                connection.sendall(piece)


class StreamSocketContract(TransportContract):
    @pytest.fixture
    def make_link(self, tmp_path):
        stop = threading.Event()
        opened = []

        def make(answer, timeout_s=1.0):
            listener, url = self.listen(tmp_path)
            peer = threading.Thread(target=serve, args=(listener, answer, stop))
            peer.start()
            link = open_transport(url, timeout_s=timeout_s)
            opened.append((listener, peer, link))
            return link

        yield make
        stop.set()
        for listener, peer, link in opened:
            link.close()
            peer.join()
            listener.close()


class TestTcp(StreamSocketContract):
    def listen(self, _tmp_path):
        listener = socket.create_server(("127.0.0.1", 0))
        return listener, f"tcp://127.0.0.1:{listener.getsockname()[1]}"


class TestUnix(StreamSocketContract):
    def listen(self, tmp_path):
        path = tmp_path / "hm.sock"
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        listener.bind(str(path))
        listener.listen()
        return listener, f"unix://{path}"


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


def test_a_port_where_nothing_listens_is_named_with_a_next_step():
    port = free_port()
    with pytest.raises(TransportError, match=f"127.0.0.1:{port}.*refused.*hm emulate"):
        open_transport(f"tcp://127.0.0.1:{port}")


def test_an_unknown_host_is_named():
    with pytest.raises(TransportError, match=r"no-such-host\.invalid"):
        open_transport("tcp://no-such-host.invalid")


def test_a_connection_that_nobody_accepts_times_out():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        port = listener.getsockname()[1]
        waiting = [socket.socket() for _ in range(8)]
        for client in waiting:
            client.settimeout(0.0)
            client.connect_ex(("127.0.0.1", port))
        with pytest.raises(TransportTimeout, match="within"):
            open_transport(f"tcp://127.0.0.1:{port}", timeout_s=0.2)
        for client in waiting:
            client.close()


def test_a_unix_path_that_does_not_exist_is_named(tmp_path):
    with pytest.raises(TransportError, match=r"none\.sock"):
        open_transport(f"unix://{tmp_path}/none.sock")


def test_an_unknown_option_is_refused():
    with pytest.raises(ConfigurationError, match="baud"):
        open_transport("tcp://127.0.0.1?baud=9600")


def test_nagle_is_switched_off():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        link = open_transport(f"tcp://127.0.0.1:{listener.getsockname()[1]}")
        assert link._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        link.close()
