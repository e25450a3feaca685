import pytest
from transport_contract import TransportContract

from hm_driver.errors import TransportClosed
from hm_driver.transport.in_process import InProcessTransport


class ScriptedPeer:
    def __init__(self, answer):
        self.answer = answer

    def handle(self, data):
        pieces = self.answer(data)
        if None in pieces:
            raise TransportClosed("the peer is gone")
        return b"".join(pieces)


class TestInProcess(TransportContract):
    is_live = False

    @pytest.fixture
    def make_link(self):
        return lambda answer: InProcessTransport(ScriptedPeer(answer))


def test_answers_to_two_messages_are_kept_in_order():
    link = InProcessTransport(ScriptedPeer(lambda data: [data]))
    link.send(b"one ")
    link.send(b"two")
    assert link.receive(0.0) == b"one two"
