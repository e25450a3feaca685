"""The device's state machine: which state may follow which, and what each one renders.

Every allowed transition is a row of :data:`TRANSITIONS`; the interpreter, the documentation
(:func:`transitions_as_markdown`) and the tests read that one table. The machine itself has no clock:
the device tells it what happened.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from hm_driver.protocol.vocabulary import State


class Event(StrEnum):
    """What makes the state change without a client asking for it."""

    INIT_FINISHED = "initialisation finished"
    INIT_FAILED = "initialisation failed"
    GUARD_TRIPPED = "a guard tripped"
    POWER_CUT = "emergency button or relay"
    CLIENT_LOST = "client lost, with on_client_lost = stop"


class Rendering(NamedTuple):
    """What the outer loop does in a state."""

    powered: bool
    """The drives have power and the servo is closed."""
    effects: bool
    """Enabled effects act on the virtual mass."""
    force_sensor: bool
    """The measured force acts on the virtual mass."""
    driven: bool
    """The device moves the arm by itself."""


RENDERING: dict[State, Rendering] = {
    State.OFF: Rendering(powered=False, effects=False, force_sensor=False, driven=False),
    State.INIT: Rendering(powered=True, effects=False, force_sensor=False, driven=True),
    State.STOP: Rendering(powered=True, effects=False, force_sensor=False, driven=False),
    State.POSITION: Rendering(powered=True, effects=True, force_sensor=False, driven=False),
    State.FORCE: Rendering(powered=True, effects=True, force_sensor=True, driven=False),
    State.HOME: Rendering(powered=True, effects=False, force_sensor=False, driven=True),
    State.FAULT: Rendering(powered=False, effects=False, force_sensor=False, driven=False),
}


class Transition(NamedTuple):
    """One allowed change of state."""

    source: State
    trigger: State | Event
    """The state that a client asks for, or what happened."""
    target: State
    needs_calibration: bool = False
    """Refused until the position is calibrated."""


def _transitions() -> Iterator[Transition]:
    calibrated = (State.POSITION, State.FORCE, State.HOME)
    powered = (State.STOP, *calibrated)
    for source in (State.OFF, *powered):
        for target in (State.OFF, State.INIT, State.STOP):
            yield Transition(source, target, target)
        for target in calibrated:
            yield Transition(source, target, target, needs_calibration=True)
    for target in (State.OFF, State.INIT, State.STOP):
        yield Transition(State.INIT, target, target)
    yield Transition(State.INIT, Event.INIT_FINISHED, State.STOP)
    yield Transition(State.INIT, Event.INIT_FAILED, State.FAULT)
    for target in (State.OFF, State.INIT):
        yield Transition(State.FAULT, target, target)
    for source in (State.INIT, *powered):
        yield Transition(source, Event.GUARD_TRIPPED, State.FAULT)
        yield Transition(source, Event.POWER_CUT, State.OFF)
        yield Transition(source, Event.CLIENT_LOST, State.STOP)


TRANSITIONS: tuple[Transition, ...] = tuple(_transitions())
"""Every allowed change of state; what is not here does not happen."""

_BY_TRIGGER: dict[tuple[State, State | Event], Transition] = {
    (transition.source, transition.trigger): transition for transition in TRANSITIONS
}

REQUESTABLE: tuple[State, ...] = tuple(state for state in State if state is not State.FAULT)
"""The states that a client may ask for with ``set state``."""


class StateRefused(ValueError):
    """A request for a state that the table does not allow now; the text says what would be accepted."""


@dataclass(slots=True)
class StateMachine:
    """The current state and the conditions that transitions depend on."""

    state: State = State.OFF
    position_calibrated: bool = False
    """The end stops have been found since the device was switched on."""
    emergency_button_pushed: bool = False
    relay_closed: bool = True
    """The emergency relay passes drive power (False while the button is pushed)."""
    fault_reason: str = ""
    """Why the state is ``fault``; empty in every other state."""

    @property
    def has_drive_power(self) -> bool:
        """Whether the drives could be powered: button released and relay closed."""
        return self.relay_closed and not self.emergency_button_pushed

    def request(self, target: State) -> None:
        """Change to the state that a client asks for.

        Raises:
            StateRefused: The table or a condition does not allow it; says why and what would be accepted.
        """
        transition = _BY_TRIGGER.get((self.state, target))
        if transition is None:
            raise StateRefused(self._why_not(target))
        if RENDERING[target].powered and not self.has_drive_power:
            cause = "the emergency button is pushed" if self.emergency_button_pushed else "the relay is off"
            raise StateRefused(f"no drive power: {cause}; accepted: off")
        if transition.needs_calibration and not self.position_calibrated:
            raise StateRefused(f"position not calibrated: set state init before {target.value}")
        self._enter(transition.target)

    def happen(self, event: Event, reason: str = "") -> bool:
        """Follow what happened; returns whether the state changed.

        Args:
            event: What happened.
            reason: Kept where the event leads to ``fault``.
        """
        transition = _BY_TRIGGER.get((self.state, event))
        if transition is None or transition.target is self.state:
            return False
        if event is Event.INIT_FINISHED:
            self.position_calibrated = True
        self._enter(transition.target)
        if self.state is State.FAULT:
            self.fault_reason = reason or event.value
        return True

    def _enter(self, target: State) -> None:
        if target is State.INIT and self.state is not State.INIT:
            self.position_calibrated = False
        self.fault_reason = ""
        self.state = target

    def _why_not(self, target: State) -> str:
        accepted = ", ".join(state.value for state in REQUESTABLE if (self.state, state) in _BY_TRIGGER)
        if self.state is State.FAULT:
            return f"in fault ({self.fault_reason}); accepted: {accepted}"
        return f"{target.value} is not allowed from {self.state.value}; accepted: {accepted}"


def transitions_as_markdown() -> str:
    """The tables of ``docs/states.md``: what each state renders, and what leads from where to where."""
    yes_no = {True: "yes", False: "no"}
    lines = [
        "| state | powered | renders effects | responds to the force sensor | moves by itself |",
        "|---|---|---|---|---|",
    ]
    for state, rendering in RENDERING.items():
        lines.append(f"| `{state.value}` | " + " | ".join(yes_no[value] for value in rendering) + " |")
    lines += ["", "| from \\ asked for | " + " | ".join(f"`{state.value}`" for state in REQUESTABLE) + " |"]
    lines.append("|---" * (len(REQUESTABLE) + 1) + "|")
    for source in State:
        cells = []
        for target in REQUESTABLE:
            transition = _BY_TRIGGER.get((source, target))
            allowed = "yes, once calibrated" if transition and transition.needs_calibration else "yes"
            cells.append(allowed if transition else "refused")
        lines.append(f"| `{source.value}` | " + " | ".join(cells) + " |")
    lines += ["", "| what happens | from | to |", "|---|---|---|"]
    for event in Event:
        rows = [transition for transition in TRANSITIONS if transition.trigger is event]
        sources = ", ".join(f"`{row.source.value}`" for row in rows)
        lines.append(f"| {event.value} | {sources} | `{rows[0].target.value}` |")
    return "\n".join(lines) + "\n"


def transitions_as_mermaid() -> str:
    """The picture of ``docs/states.md``: a state diagram, a state's like answers drawn as one arrow each."""
    labels: dict[tuple[str, str], list[str]] = {}
    for transition in TRANSITIONS:
        if transition.source is transition.target:
            continue
        asked = isinstance(transition.trigger, State)
        label = "set state" if asked else transition.trigger.value
        if transition.needs_calibration:
            label += ", once calibrated"
        labels.setdefault((transition.source.value, transition.target.value), []).append(label)
    lines = ["stateDiagram-v2", "    [*] --> off"]
    lines += [f"    {source} --> {target}: {' / '.join(texts)}" for (source, target), texts in labels.items()]
    return "\n".join(lines) + "\n"
