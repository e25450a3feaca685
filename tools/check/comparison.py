"""Ask a device what docs/fidelity.md says about it, and keep every word that was exchanged."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from hm_driver.device.link import CommandLink
from hm_driver.errors import DeviceError, ProtocolError, TransportError


class Verdict(Enum):
    """How an answer stands to the table."""

    SAME = "same"
    """The device does what the table says."""
    DIFFERS = "differs"
    """It does something else."""
    UNKNOWN = "unknown"
    """It could not be asked, or its answer tells nothing."""


class Exchange(NamedTuple):
    """One command and what came back."""

    command: str
    reply: str
    """The reply, a refusal, or what went wrong in angle brackets."""
    took_ms: float


class Answer(NamedTuple):
    """What a question found."""

    expected: str
    got: str
    verdict: Verdict


class Finding(NamedTuple):
    """One fact, asked."""

    question: str
    fact: str
    """First column of the fidelity table."""
    confidence: str
    expected: str
    got: str
    verdict: Verdict


class Conversation:
    """A link that remembers.

    Args:
        link: Connection to the device.
        reopen: Opens another connection to it, and says whether that one was answered.
    """

    def __init__(self, link: CommandLink, *, reopen: Callable[[], str] | None = None) -> None:
        self._link = link
        self._reopen = reopen
        self.exchanges: list[Exchange] = []

    @property
    def dialect(self) -> str:
        """``text`` or ``framed``."""
        return self._link.dialect.value

    def ask(self, command: str) -> str:
        """The answer to a request, bare; a refusal is one too, and is returned as it came.

        Raises:
            TransportError: The device is gone.
        """
        started = time.perf_counter()
        try:
            reply = self._link.exchange(command)
        except DeviceError as error:
            reply = error.reply
        except (TransportError, ProtocolError) as error:
            self._note(command, f"<{type(error).__name__}: {error}>", started)
            if isinstance(error, TransportError) and not self._can_go_on():
                raise
            return ""
        self._note(command, reply, started)
        return reply.rstrip("; ").strip('"')

    def ask_beside(self) -> str:
        """What a second connection is answered, while this one stays; empty where it is not."""
        if self._reopen is None:
            return ""
        started = time.perf_counter()
        try:
            reply = self._reopen()
        except (TransportError, ProtocolError, DeviceError) as error:
            reply = f"<{type(error).__name__}: {error}>"
        self._note("get state (second connection)", reply, started)
        return "" if reply.startswith("<") else reply

    def _can_go_on(self) -> bool:
        """Whether a new connection is answered; a device may have hung up on a request that it dislikes."""
        try:
            self._link.reconnect()
        except TransportError:
            return False
        return True

    def _note(self, command: str, reply: str, started: float) -> None:
        self.exchanges.append(Exchange(command, reply, round((time.perf_counter() - started) * 1e3, 3)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """How one fact is asked for."""

    name: str
    fact: str
    """First column of the fidelity table."""
    confidence: str
    """As in the table."""
    ask: Callable[[Conversation], Answer]


def compare(conversation: Conversation, questions: Sequence[Question]) -> list[Finding]:
    """Ask every question.

    Raises:
        TransportError: The device is gone.
    """
    findings = []
    for question in questions:
        expected, got, verdict = question.ask(conversation)
        findings.append(
            Finding(question.name, question.fact, question.confidence, expected, got[:200], verdict)
        )
    return findings


def judge(expected: str, got: str, *, is_same: bool) -> Answer:
    """An answer; one that is empty tells nothing."""
    verdict = Verdict.UNKNOWN if not got else Verdict.SAME if is_same else Verdict.DIFFERS
    return Answer(expected, got or "no answer", verdict)
