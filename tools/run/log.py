"""What a session writes into its log, beside what the loop writes itself."""

from collections.abc import Sequence

from hm_driver.recording.ring import Ring
from hm_driver.recording.schemas import EVENT, EVENT_LEVELS, EVENTS_CHANNEL
from teaching.hands.contract import HandIntent, Vector
from teaching.messages import (
    ARBITRATION,
    ARBITRATION_CHANNEL,
    HAND_STATE,
    HAND_STATE_CHANNEL,
    LEARNER_STATE_CHANNEL,
    pack_learner_state,
)
from teaching.session import Tick, Update

_NOWHERE: Vector = (0.0, 0.0, 0.0)


class SessionLog:
    """Packs what happens in the session's ticks into a ring.

    Args:
        ring: Where the records go; drained by the recorder.
        reference_force: Force that the task asks for [N], repeated in each tick for whoever plots it.
    """

    def __init__(self, ring: Ring, *, reference_force: float) -> None:
        self._ring = ring
        self._reference_force = reference_force
        self._events = 0

    def tick(self, time_ns: int, tick: Tick) -> None:
        """Log who was in control and what each of the two wanted."""
        payload = ARBITRATION.pack(
            time_ns,
            int(tick.stage),
            tick.C,
            tick.w_max,
            tick.x,
            tick.y,
            tick.depth,
            tick.y_demo,
            tick.y_robot,
            tick.y_cmd,
            max(0.0, tick.y_handle),
            tick.force,
            self._reference_force,
            tick.stiffness,
            tick.accumulated,
            tick.recorded,
            tick.is_learning,
            tick.std,
        )
        self._ring.write(ARBITRATION_CHANNEL.id, time_ns, payload)
        if tick.update is not None:
            self.update(time_ns, tick.update)
        for name, text in tick.events:
            self.event(time_ns, name, text)

    def update(self, time_ns: int, update: Update) -> None:
        """Log the whole learner."""
        payload = pack_learner_state(
            time_ns, update.number, update.coverage, update.learner, cause=int(update.cause)
        )
        self._ring.write(LEARNER_STATE_CHANNEL.id, time_ns, payload)

    def hand(
        self, time_ns: int, intent: HandIntent | None, hand_force: Vector, contact_force: Vector
    ) -> None:
        """Log what a simulated hand intended and felt."""
        position, velocity, stiffness, damping, extra = (
            intent if intent is not None else (_NOWHERE, _NOWHERE, _NOWHERE, _NOWHERE, _NOWHERE)
        )
        payload = HAND_STATE.pack(
            time_ns, *position, *velocity, *stiffness, *hand_force, *contact_force, *damping, *extra
        )
        self._ring.write(HAND_STATE_CHANNEL.id, time_ns, payload)

    def event(
        self, time_ns: int, name: str, text: str, *, level: str = "info", values: Sequence[float] = ()
    ) -> None:
        """Log something that happened once.

        Args:
            time_ns: Time of the session's clock, since the Unix epoch [ns].
            name: Short name, to search for.
            text: What happened, in words.
            level: ``debug``, ``info``, ``warning`` or ``error``.
            values: Numbers that belong to it.
        """
        self._events += 1
        payload = EVENT.pack(self._events, time_ns, EVENT_LEVELS[level], name, text, list(values))
        self._ring.write(EVENTS_CHANNEL.id, time_ns, payload)
