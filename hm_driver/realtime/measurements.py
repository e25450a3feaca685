"""From a device's replies to nine numbers, by the shortest way that still refuses what is malformed."""

from typing import Protocol

from hm_driver.errors import ProtocolError
from hm_driver.protocol.replies import parse_word

QUESTIONS = ("get measpos", "get measvel", "get measforce")
"""What is asked in each cycle, in the order of the cycle function's measurement."""
STATE_QUESTION = "get state"


class CycleLink(Protocol):
    """What the loop needs of a connection: one command out, one reply back, errors as exceptions.

    ``exchange`` raises `hm_driver.errors.DeviceError` where the device refuses a command, and
    `hm_driver.errors.TransportError` where the peer is silent or gone.
    """

    combined: bool
    """Whether one request may hold several commands, joined by ``;``."""

    def exchange(self, command: str) -> str:
        """Send a command, or several joined by ``;``, and return the whole reply."""
        ...


def parse_measurement(text: str, measurement: list[float]) -> None:
    """Read ``[x,y,z];[x,y,z];[x,y,z]`` into nine floats in place.

    Infinities and NaN pass: the cycle function trips on them.

    Raises:
        ProtocolError: Anything but three vectors of three numbers.
    """
    if text[:1] == "[" and text[-1:] == "]":
        try:
            values = list(map(float, text[1:-1].replace("];[", ",").split(",")))
        except ValueError:
            values = []
        if len(values) == 9 and text.count("];[") == 2:
            measurement[:] = values
            return
    raise ProtocolError(f"reply {text[:100]!r} is not [x,y,z];[x,y,z];[x,y,z]", received=text)


class Exchange:
    """One cycle's exchange with the device.

    A link that combines takes one request: the changes, then the questions. Otherwise each command is a
    request of its own.

    Args:
        link: Connection of the loop.
    """

    __slots__ = ("_exchange", "_is_combined", "_questions", "_questions_and_state", "requests", "state")

    def __init__(self, link: CycleLink) -> None:
        self._exchange = link.exchange
        self._is_combined = link.combined
        self._questions = "; ".join(QUESTIONS)
        self._questions_and_state = "; ".join((*QUESTIONS, STATE_QUESTION))
        self.requests = 0
        """Requests sent so far."""
        self.state = ""
        """The device's state, as last asked."""

    def run(self, changes: list[str], measurement: list[float], *, ask_state: bool = False) -> None:
        """Send the changes, ask for the measurements, and read them into ``measurement``.

        Args:
            changes: Set-commands.
            measurement: Nine floats, changed in place.
            ask_state: Whether to ask for the device's state too.

        Raises:
            DeviceError: The device refused a command.
            ProtocolError: A reply is malformed.
            TransportError: The device did not answer in time, or the link is cut.
        """
        if not self._is_combined:
            self._run_one_by_one(changes, measurement, ask_state=ask_state)
            return
        questions = self._questions_and_state if ask_state else self._questions
        request = "; ".join((*changes, questions)) if changes else questions
        self.requests += 1
        reply = self._exchange(request)
        count = len(changes)
        if reply.count(";") != count + (4 if ask_state else 3):
            raise ProtocolError(
                f"reply {reply[:100]!r} has not one part for each command of {request!r}", received=reply
            )
        end = reply.rfind("]")
        parse_measurement(reply[reply.find("[") : end + 1], measurement)
        if ask_state:
            self.state = reply[end + 2 :].rstrip(";")

    def _run_one_by_one(self, changes: list[str], measurement: list[float], *, ask_state: bool) -> None:
        for command in changes:
            self._ask(command)
        parse_measurement(";".join([self._ask(question) for question in QUESTIONS]), measurement)
        if ask_state:
            self.state = parse_word(self._ask(STATE_QUESTION))

    def _ask(self, command: str) -> str:
        self.requests += 1
        return self._exchange(command).rstrip(";")
