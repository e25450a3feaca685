"""Runs a session's ticks: the one place where loop, hand, log and view meet, on either clock."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

from hm_driver.realtime.clock import Clock
from hm_driver.realtime.setpoint import LoopState, SetPoint
from teaching.hands.contract import Hand, HandIntent, Vector
from teaching.session import Session, Stage, Tick
from tools.run.options import TICK_S

TICK_NS = round(TICK_S * 1e9)
LONGEST_STEP_NS = 2 * TICK_NS
"""A simulated hand does not catch up with what a stalled machine missed: it would have to jump."""


class Felt(NamedTuple):
    """What only a simulation knows of the hand, for the log."""

    time_ns: int
    """Time of the tick that sent the intent, on the log's clock [ns]."""
    intent: HandIntent | None
    """What the hand intended then; None where it let go."""
    hand_force: Vector
    """True force of the hand on the end effector [N]."""
    contact_force: Vector
    """True force of rendered objects on the end effector [N]."""


class Loop(Protocol):
    """The driver's loop as the session sees it: in its own process, or in lock-step."""

    def state(self) -> LoopState:
        """The newest state of the loop."""
        ...

    def publish(self, set_point: SetPoint) -> None:
        """Hand over the set-point; counts as the application's heartbeat."""
        ...

    def check(self) -> None:
        """Raise what ended the loop, if it has ended.

        Raises:
            SafetyTrip: A limit tripped, and the arm was made safe.
            DeviceFault: The device is in no state to go on.
            LoopError: The loop died.
        """
        ...


class World(Protocol):
    """Where a simulated hand takes hold of the emulated arm."""

    def move(self, time_ns: int, intent: HandIntent | None) -> list[Felt]:
        """Carry the hand's intent over, None to let go; returns what this or earlier intents were met with.

        Must not wait for a peer that a busy machine may hold up.

        Args:
            time_ns: Time of the tick on the log's clock [ns].
            intent: What the hand intends.
        """
        ...


class Log(Protocol):
    """Where the session's ticks go."""

    def tick(self, time_ns: int, tick: Tick) -> None:
        """Note who was in control and what each of the two wanted."""
        ...

    def hand(
        self, time_ns: int, intent: HandIntent | None, hand_force: Vector, contact_force: Vector
    ) -> None:
        """Note what a simulated hand intended and felt."""
        ...


class View(Protocol):
    """Whoever watches the session; must return at once."""

    def show(self, time_s: float, session: Session, tick: Tick, state: LoopState) -> None:
        """Show the session after a tick."""
        ...

    def tell(self, text: str) -> None:
        """Tell what befell the session's log; called from any thread."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Plugs:
    """What differs between real time and lock-step, emulator and robot, simulated hand and person."""

    clock: Clock
    loop: Loop
    hand: Hand
    world: World | None
    log: Log
    view: View


def run_ticks(session: Session, plugs: Plugs, *, start_ns: int, epoch_ns: int) -> float:
    """Tick the session on an absolute grid until it is done.

    A tick that a stalled machine missed is skipped, and the next one gets the true time step.

    Args:
        session: The session.
        plugs: What it is connected to.
        start_ns: Time of the first tick on the plugs' clock [ns].
        epoch_ns: What is to be added to the clock's time to get the time of the log [ns].

    Returns:
        Duration of the session on its clock [s].

    Raises:
        SafetyTrip: A limit below the modes tripped; the arm was made safe.
        DeviceFault: The device failed.
        LoopError: The loop died.
    """
    clock, loop, log = plugs.clock, plugs.loop, plugs.log
    deadline_ns, last_ns = start_ns, start_ns - TICK_NS
    while session.stage is not Stage.DONE:
        clock.sleep_until_ns(deadline_ns)
        loop.check()
        state = loop.state()
        tick = session.tick(state, (deadline_ns - last_ns) * 1e-9)
        loop.publish(tick.set_point)
        time_ns = deadline_ns + epoch_ns
        log.tick(time_ns, tick)
        if plugs.world is not None:
            intent = plugs.hand.step(tick.seen, min(deadline_ns - last_ns, LONGEST_STEP_NS) * 1e-9)
            session.is_pressed = plugs.hand.button
            for felt in plugs.world.move(time_ns, intent):
                log.hand(felt.time_ns, felt.intent, felt.hand_force, felt.contact_force)
        plugs.view.show((deadline_ns - start_ns) * 1e-9, session, tick, state)
        last_ns = deadline_ns
        behind = max(0, clock.now_ns() - deadline_ns) // TICK_NS
        deadline_ns += (1 + behind) * TICK_NS
    return (last_ns - start_ns) * 1e-9
