"""What a word gets to work with."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hm_driver.errors import LoopError
from tools.drive.console import Console
from tools.drive.session import Drive

if TYPE_CHECKING:
    from tools.drive.language import Word


@dataclass(slots=True)
class Context:
    """A drive, and where its words are said.

    Args:
        console: Where results go.
        words: The language.
        is_one_shot: Whether the words came on the command line.
    """

    console: Console
    words: "Mapping[str, Word[Context]]"
    is_one_shot: bool = False
    opened: Drive | None = None
    """The drive; None until a device is there."""
    is_followed: bool = False
    """Whether other commands wait behind the one that is carried out: what shows without end shows once."""
    is_over: bool = False
    """Whether a word asked for the end."""

    @property
    def drive(self) -> Drive:
        """The drive.

        Raises:
            LoopError: There is no device yet.
        """
        if self.opened is None:
            raise LoopError("there is no device yet")
        return self.opened
