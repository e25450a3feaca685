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
_TAILS = tuple(tail.encode() for tail in TAILS)
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

    def send_line(self, line: bytes) -> None:
        """Send a line of the text dialect."""
        ...

    def receive_line(self) -> bytes:
        """Return the line that answers the one sent last, refusals included."""
        ...


def parse_measurement(text: bytes) -> list[float]:
    """Read ``x,y,z];[x,y,z];[x,y,z``, without the outer brackets, as nine floats.

    Infinities and NaN pass: the cycle function trips on them.

    Raises:
        ProtocolError: Anything but three vectors of three numbers.
    """
    try:
        position, velocity, force = text.split(b"];[")
        x, y, z = position.split(b",")
        vx, vy, vz = velocity.split(b",")
        fx, fy, fz = force.split(b",")
        return [
            float(x), float(y), float(z), float(vx), float(vy), float(vz), float(fx), float(fy), float(fz)
        ]  # fmt: skip
    except ValueError:
        shown = text[:100].decode(errors="replace")
        raise ProtocolError(f"'[{shown}]' is not [x,y,z];[x,y,z];[x,y,z]", received=shown) from None


class Exchange:
    """One cycle's exchange, in two halves: what is between them goes on while the device answers.

    A link that combines takes one request: the changes, then the questions. Otherwise each command is a
    request of its own, and all of them belong to the second half.

    Args:
        link: Connection of the loop.
    """

    __slots__ = (
        "_asks_state",
        "_changes",
        "_is_combined",
        "_line",
        "_link",
        "requests",
        "state",
    )

    def __init__(self, link: CycleLink) -> None:
        self._link = link
        self._is_combined = link.combined
        self._changes: list[str] = []
        self._asks_state = False
        self._line = b""
        self.requests = 0
        """Requests sent so far."""
        self.state = ""
        """The device's state, as last asked."""

    def begin(self, changes: list[str], *, ask_state: bool = False) -> None:
        """Send the changes and the questions.

        Args:
            changes: Set-commands.
            ask_state: Whether to ask for the device's state too.

        Raises:
            TransportError: The device takes nothing, or the link is cut.
        """
        self._changes = changes
        self._asks_state = ask_state
        if self._is_combined:
            tail = _TAILS[ask_state]
            self._line = line = f"{'; '.join(changes)}; ".encode() + tail if changes else tail
            self.requests += 1
            self._link.send_line(line)

    def finish(self) -> list[float]:
        """Read the answers; returns the measurement of the cycle function, nine floats.

        Raises:
            DeviceError: The device refused a command.
            ProtocolError: A reply is malformed.
            TransportError: The device did not answer in time, or the link is cut.
        """
        if not self._is_combined:
            return self._run_one_by_one()
        reply = self._link.receive_line()
        start, end = reply.find(b"[") + 1, reply.rfind(b"]")
        if (start != 1 or self._changes or self._asks_state) or len(reply) != end + 3:
            self._check(reply, start)
        try:
            measurement = parse_measurement(reply[start:end])
        except ProtocolError as error:
            self._check(reply, start)
            raise error.about(self._line.decode().strip()) from error
        if self._asks_state:
            self.state = reply[end + 2 :].decode(errors="replace").rstrip("; \r\n")
        return measurement

    def _check(self, reply: bytes, start: int) -> None:
        """Look closely at a reply that holds more than the measurements."""
        if _ERROR_MARK in reply:
            raise DeviceError(*_find_refused(self._line, reply))
        expected = len(self._changes)
        if reply.count(b";") != expected + 3 + self._asks_state or reply.count(b";", 0, start) != expected:
            shown = reply[:100].decode(errors="replace")
            problem = ProtocolError(f"reply {shown!r} has not one part for each command", received=shown)
            raise problem.about(self._line.decode().strip())

    def _run_one_by_one(self) -> list[float]:
        for command in self._changes:
            self._ask(command)
        vectors = ";".join([self._ask(question) for question in QUESTIONS])
        if vectors[:1] + vectors[-1:] != "[]":
            raise ProtocolError(f"reply {vectors[:100]!r} is not three vectors", received=vectors)
        measurement = parse_measurement(vectors[1:-1].encode())
        if self._asks_state:
            self.state = parse_word(self._ask(STATE_QUESTION))
        return measurement

    def _ask(self, command: str) -> str:
        self.requests += 1
        return self._link.exchange(command).rstrip(";")


def _find_refused(line: bytes, reply: bytes) -> tuple[str, str]:
    """The command of a request that was refused, and its reply."""
    for command, part in zip(line.split(b"; "), reply.split(b";"), strict=False):
        if _ERROR_MARK in part:
            return command.decode().strip(), part.decode(errors="replace")
    return line.decode().strip(), reply.decode(errors="replace").strip()
