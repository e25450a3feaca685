"""The live view of a session in the terminal, drawn by a process of its own."""

from tools.live.status import SessionStatus
from tools.live.view import LiveView

__all__ = ["LiveView", "SessionStatus"]
