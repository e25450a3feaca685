"""One cycle's exchange with the device, by the shortest way that still refuses what is malformed."""

from typing import Protocol

from hm_driver.errors import DeviceError, ProtocolError
from hm_driver.protocol.replies import parse_word
from hm_driver.protocol.vocabulary import ERROR_MARK

QUESTIONS = ("get measpos", "get modelvel", "get measforce")
"""What is asked in each cycle, in the order of the cycle function's measurement. The springs act on the
virtual mass, whose velocity is known exactly; the measured one is the noisy difference of encoder counts."""
STATE_QUESTION = "get state"
TAILS = ("; ".join(QUESTIONS) + "\n", "; ".join((*QUESTIONS, STATE_QUESTION)) + "\n")
"""How each combined request ends: without and with the question for the state."""
_ERROR_MARK = ERROR_MARK.encode()


class CycleLink(Protocol):
    """What the loop needs of a connection: one request out, one reply back, errors as exceptions.

    Both ways raise `hm_driver.errors.TransportError` where the peer is silent or gone.
    """

    combined: bool
    """Whether one request may hold several commands, joined by ``;``; the text dialect then."""

    def exchange(self, request: str) -> str:
        """Send a command and return its reply; raises `hm_driver.errors.DeviceError` where it is refused."""
        ...

    def exchange_line(self, line: bytes) -> bytes:
        """Send a line of the text dialect, return the line that answers it, refusals included."""
        ...


def parse_measurement(text: bytes, measurement: list[float]) -> None:
    """Read ``x,y,z];[x,y,z];[x,y,z``, without the outer brackets, into nine floats in place.

    Infinities and NaN pass: the cycle function trips on them.

    Raises:
        ProtocolError: Anything but three vectors of three numbers.
    """
    try:
        values = list(map(float, text.replace(b"];[", b",").split(b",")))
    except ValueError:
        values = []
    if len(values) != 9 or text.count(b"];[") != 2:
        shown = text[:100].decode(errors="replace")
        raise ProtocolError(f"'[{shown}]' is not [x,y,z];[x,y,z];[x,y,z]", received=shown)
    measurement[:] = values


class Exchange:
    """One cycle's exchange.

    A link that combines takes one request: the changes, then the questions. Otherwise each command is a
    request of its own.

    Args:
        link: Connection of the loop.
    """

    __slots__ = ("_is_combined", "_link", "requests", "state")

    def __init__(self, link: CycleLink) -> None:
        self._link = link
        self._is_combined = link.combined
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
        tail = TAILS[ask_state]
        line = f"{'; '.join(changes)}; {tail}".encode() if changes else tail.encode()
        self.requests += 1
        reply = self._link.exchange_line(line)
        if _ERROR_MARK in reply:
            raise DeviceError(*_find_refused(line, reply))
        if reply.count(b";") != len(changes) + 3 + ask_state:
            shown = reply[:100].decode(errors="replace")
            raise ProtocolError(f"reply {shown!r} has not one part for each command", received=shown)
        end = reply.rfind(b"]")
        parse_measurement(reply[reply.find(b"[") + 1 : end], measurement)
        if ask_state:
            self.state = reply[end + 2 :].decode(errors="replace").rstrip("; \r\n")

    def _run_one_by_one(self, changes: list[str], measurement: list[float], *, ask_state: bool) -> None:
        for command in changes:
            self._ask(command)
        vectors = ";".join([self._ask(question) for question in QUESTIONS])
        if vectors[:1] + vectors[-1:] != "[]":
            raise ProtocolError(f"reply {vectors[:100]!r} is not three vectors", received=vectors)
        parse_measurement(vectors[1:-1].encode(), measurement)
        if ask_state:
            self.state = parse_word(self._ask(STATE_QUESTION))

    def _ask(self, command: str) -> str:
        self.requests += 1
        return self._link.exchange(command).rstrip(";")


def _find_refused(line: bytes, reply: bytes) -> tuple[str, str]:
    """The command of a request that was refused, and its reply."""
    for command, part in zip(line.split(b"; "), reply.split(b";"), strict=False):
        if _ERROR_MARK in part:
            return command.decode().strip(), part.decode(errors="replace")
    return line.decode().strip(), reply.decode(errors="replace").strip()
