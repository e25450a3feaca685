"""What the doctor says of one property of the machine."""

from dataclasses import asdict, dataclass
from enum import StrEnum


class State(StrEnum):
    """How good a finding is."""

    GOOD = "good"
    """As it should be."""
    NOTE = "note"
    """Can be better, or matters to some."""
    BAD = "bad"
    """Stands in the way of punctuality."""
    UNKNOWN = "unknown"
    """This platform does not tell."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One property."""

    name: str
    """Its key in the JSON."""
    title: str
    value: str
    """What was found."""
    state: State
    why: str = ""
    """What it means for the loop, where it is not good."""
    change: str = ""
    """What to do about it, with the command."""

    def as_dict(self) -> dict[str, str]:
        """Plain values, for JSON."""
        return asdict(self) | {"state": str(self.state)}


def unknown(name: str, title: str, *, missing: str) -> Finding:
    """A finding that this platform does not tell.

    Args:
        name: Its key.
        title: Its name for people.
        missing: What was not there.
    """
    return Finding(name=name, title=title, value=f"not told here ({missing})", state=State.UNKNOWN)
