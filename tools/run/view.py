"""From a session's tick to what the live view shows, ten times a second."""

from hm_driver.realtime.setpoint import LoopState
from teaching.session import Session, Tick
from tools.live import LiveView, SessionStatus
from tools.run.keyboard import HELP, Keyboard, Wishes

_EVERY = 10
_TOLD = ("update", "forget", "forget all", "undo", "discard", "insist")
"""Events that are shown."""


class SessionView:
    """Feeds a live view from the ticks.

    Args:
        live: The view.
        accumulation_length: N_acc.
        coverage_goal: Coverage at which the session becomes autonomous.
    """

    def __init__(self, live: LiveView, *, accumulation_length: int, coverage_goal: float) -> None:
        self._live = live
        self._accumulation_length = accumulation_length
        self._coverage_goal = coverage_goal
        self._ticks = 0
        self._last = LoopState()
        self._keyboard = Keyboard()
        self._wishes = Wishes()
        self._messages = [HELP] if self._keyboard.is_there else []
        self.session_s = 0.0
        """Duration of the session so far [s]."""
        self.session: Session | None = None

    def show(self, time_s: float, session: Session, tick: Tick, state: LoopState) -> None:
        """Show the session after a tick."""
        self.session_s, self.session = time_s, session
        for name, text in tick.events:
            if name in _TOLD:
                self._messages.append(text if name == "update" else f"{name}: {text}")
        self._ticks += 1
        if self._ticks % _EVERY:
            return
        for line in self._keyboard.lines():
            self._messages += filter(None, [self._wishes.obey(line, session)])
        messages, self._messages = self._messages, []
        elapsed_ns = state.time_ns - self._last.time_ns
        rate = (state.cycle - self._last.cycle) * 1e9 / elapsed_ns if elapsed_ns > 0.0 else None
        self._live.update(
            SessionStatus(
                time_s=time_s,
                stage=tick.stage.name.lower(),
                C=tick.C,
                force_n=tick.force,
                reference_force_n=session.task.reference_force,
                models=session.learner.n_models,
                coverage=session.coverage,
                updates=session.updates,
                accumulated=tick.accumulated,
                accumulation_length=self._accumulation_length,
                loop_rate_hz=rate,
                missed_periods=int(state.missed),
                lateness_p99_us=None,
                scheduling="",
                coverage_goal=self._coverage_goal,
                messages=tuple(messages),
            )
        )
        self._last = state

    def tell(self, text: str) -> None:
        """Tell something with the next status."""
        self._messages.append(text)
