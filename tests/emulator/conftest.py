import socket
import time
from urllib.parse import urlsplit

import pytest


class TextClient:
    """A client in the text dialect, as plain as a socket."""

    def __init__(self, url, *, timeout=5.0):
        parts = urlsplit(url)
        self.socket = socket.create_connection((parts.hostname, parts.port), timeout=timeout)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, data):
        self.socket.sendall(data)

    def ask(self, text):
        self.send(text.encode() + b"\n")
        reply = b""
        while not reply.endswith(b"\n"):
            data = self.socket.recv(65536)
            if not data:
                raise ConnectionResetError
            reply += data
        return reply.decode()[:-1]

    def wait_for_state(self, state, timeout=20.0):
        deadline = time.monotonic() + timeout
        while self.ask("get state") != f"{state};":
            assert time.monotonic() < deadline, f"{self.ask('get state')} instead of {state}"
            time.sleep(0.01)

    def is_cut(self):
        """Whether the emulator hangs up; reads away what it says before."""
        try:
            while self.socket.recv(65536):
                pass
        except TimeoutError:
            return False
        except OSError:
            pass
        return True

    def close(self):
        self.socket.close()


@pytest.fixture(scope="module")
def emulator():
    """An emulator that all tests of a module share."""
    from emulator import Emulator

    with Emulator(init_seconds=0.3) as emulator:
        yield emulator


@pytest.fixture
def connect():
    """Opens text clients, closes them at the end."""
    clients = []

    def open_client(emulator, **options):
        clients.append(TextClient(emulator.url, **options))
        return clients[-1]

    yield open_client
    for client in clients:
        client.close()
