"""The emulated device: state machine, objects and arm in one, with time told by the count of steps."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import cast

from emulator.agenda import Agenda
from emulator.arm_model import ArmModel
from emulator.effect_table import CAPACITY, EffectKind
from emulator.grid import STEP_RATE_HZ
from emulator.guards import Guards
from emulator.layout import O_GUARD
from emulator.parameters import ArmParameters
from emulator.state_machine import RENDERING, Event, StateMachine, StateRefused
from hm_driver.errors import ConfigurationError, ProtocolError
from hm_driver.protocol.vocabulary import (
    Kind,
    ObjectType,
    Parameter,
    State,
    Value,
    check_name,
    object_type,
)

Joints = tuple[float, float, float]

HOME_POSE: Joints = (0.0, 0.0, 0.0)
"""Joints r [m], phi [rad], z [m] of the home pose: the centre of the workspace (a choice)."""

HOMING_PATIENCE_S = 10.0
"""How much longer than planned an initialisation may take to reach the home pose [s]."""


class InitOutcome(Enum):
    """How an initialisation goes."""

    NORMAL = "normal"
    FAILS = "fails"
    """An end stop is not found: the device goes to ``fault``."""
    NEVER_ENDS = "never ends"
    """It goes on searching until it is told otherwise."""


@dataclass(slots=True)
class DeviceObject:
    """An effect or a shape that a client created."""

    type: ObjectType
    slot: int
    """Row of the arm's effect table."""
    is_enabled: bool = False


class EmulatedDevice:
    """What the command language acts on; time passes only in `advance`.

    Args:
        parameters: The arm.
        seed: Of the sensors' noise.
        init_seconds: Device time that an initialisation takes [s]; longer where the drive home does.
        guards: Limits that put the device into ``fault``.

    Raises:
        ConfigurationError: An argument is out of range.
    """

    def __init__(
        self,
        parameters: ArmParameters,
        *,
        seed: int = 0,
        init_seconds: float = 3.0,
        guards: Guards | None = None,
    ) -> None:
        if not 0.0 <= init_seconds <= 600.0:
            raise ConfigurationError("init_seconds", f"{init_seconds} s must be 0 to 600")
        if parameters.rate_hz != STEP_RATE_HZ:
            raise ConfigurationError(
                "control.rate", f"{parameters.rate_hz:g} Hz: the device runs at {STEP_RATE_HZ} Hz"
            )
        self.parameters = parameters
        self.geometry = parameters.geometry
        self.arm = ArmModel(parameters, seed=seed)
        self.machine = StateMachine()
        self.objects: dict[str, DeviceObject] = {}
        self.is_force_calibrated = False
        self.init_seconds = init_seconds
        self.init_outcome = InitOutcome.NORMAL
        self.agenda = Agenda()
        self.step = 0
        """Steps run so far: the device's time in units of 400 µs."""
        self._guards = guards or Guards()
        self._init_deadline = 0
        self.arm.set_guards(
            speed=self._guards.speed,
            force=self._guards.force,
            following_error=self._guards.following_error,
        )
        self.arm.warm_up()
        self._outputs = self.arm.outputs.data
        self._render()

    @property
    def state(self) -> State:
        """State of the device."""
        return self.machine.state

    @property
    def time_s(self) -> float:
        """Device time [s]."""
        return self.step / STEP_RATE_HZ

    @property
    def outputs(self) -> memoryview:
        """Numbers of the arm's output array, laid out as `emulator.layout` says."""
        return self._outputs

    @property
    def effect_rows(self) -> memoryview:
        """Bytes of the rows of all objects: doubles, laid out as `emulator.layout` says."""
        return self.arm.effects.flat.data.cast("B")

    def advance(self, steps: int) -> None:
        """Run `steps` steps of 400 µs, and on the way what is due."""
        end = self.step + steps
        while self.step < end:
            until = min(end, self.agenda.next_step)
            self.ran_to(self.step + self.arm.step(until - self.step))
            if self.step >= self.agenda.next_step:
                self.agenda.run_due(self.step)

    def ran_to(self, step: int) -> None:
        """Note that the arm was run up to a step, at which nothing but a guard's trip can be due."""
        self.step = step
        if self._outputs[O_GUARD] and self.machine.happen(
            Event.GUARD_TRIPPED, self._guards.violation(self._outputs)
        ):
            self._changed_state()

    def request_state(self, target: State) -> None:
        """Change to a state that a client asks for.

        Raises:
            ProtocolError: Not allowed now; the text says why and what would be accepted.
        """
        before = self.machine.state
        try:
            self.machine.request(target)
        except StateRefused as refusal:
            raise ProtocolError(str(refusal)) from None
        if self.machine.state is not before:
            self._changed_state()

    def client_lost(self) -> None:
        """Come to rest because a client that commanded is gone."""
        if self.machine.happen(Event.CLIENT_LOST):
            self._changed_state()

    def set_emergency(self, *, button_pushed: bool | None = None, relay_closed: bool | None = None) -> None:
        """Push or release the emergency button, open or close the relay; a pushed button opens the relay."""
        machine = self.machine
        if button_pushed is not None:
            machine.emergency_button_pushed = button_pushed
        if relay_closed is not None:
            machine.relay_closed = relay_closed
        if not machine.has_drive_power and machine.happen(Event.POWER_CUT):
            self._changed_state()

    def calibrate_force_sensor(self) -> None:
        """Take the force that is measured now for zero.

        Raises:
            ProtocolError: An initialisation is going on; it calibrates by itself.
        """
        if self.state is State.INIT:
            raise ProtocolError("initialising, which calibrates the force sensor; wait for state stop")
        self.arm.calibrate_force_sensor()
        self.is_force_calibrated = True

    def create(self, type_name: str, name: str) -> None:
        """Create an object, disabled, with the defaults of its type.

        Raises:
            ProtocolError: Unknown type, impossible or taken name, or no room left.
        """
        kind = object_type(type_name)
        check_name(name)
        if name in self.objects:
            raise ProtocolError(
                f"{name[:24]!r} exists already, a {self.objects[name].type.name}; remove it first"
            )
        if len(self.objects) >= CAPACITY:
            raise ProtocolError(f"no room: {CAPACITY} objects exist already; remove one first")
        entry = DeviceObject(kind, self.arm.effects.allocate(EffectKind(type_name)))
        for parameter in kind.parameters.values():
            self._write(entry, parameter.name, parameter.default)
        self.objects[name] = entry

    def remove(self, name: str) -> None:
        """Remove an object.

        Raises:
            ProtocolError: No such object.
        """
        self.arm.effects.free(self.find(name).slot)
        del self.objects[name]

    def remove_all(self) -> None:
        """Remove every object."""
        for entry in self.objects.values():
            self.arm.effects.free(entry.slot)
        self.objects.clear()

    def enable(self, name: str, *, is_enabled: bool) -> None:
        """Enable or disable an object.

        Raises:
            ProtocolError: No such object.
        """
        self._enable(self.find(name), is_enabled=is_enabled)

    def set_parameter(self, name: str, parameter: str, value: Value) -> None:
        """Set a parameter of an object.

        Raises:
            ProtocolError: No such object or parameter, or a value that the parameter does not take.
        """
        entry = self.find(name)
        self._write(entry, parameter, entry.type.parameter(parameter).check(value))

    def read_parameter(self, entry: DeviceObject, parameter: Parameter) -> Value:
        """Value of a parameter of an object."""
        value = self.arm.effects.get(entry.slot, parameter.name)
        if parameter.kind is Kind.BOOL:
            return bool(value)
        return cast("Value", value)

    def find(self, name: str) -> DeviceObject:
        """Look up an object.

        Raises:
            ProtocolError: No such object; the text names those there are.
        """
        try:
            return self.objects[name]
        except KeyError:
            known = " ".join(self.objects) or "none"
            shown = known if len(known) <= 60 else f"{known[:57]}..."
            raise ProtocolError(f"no object {name[:24]!r}; there are: {shown}") from None

    def _write(self, entry: DeviceObject, parameter: str, value: Value) -> None:
        if isinstance(value, str):
            raise ProtocolError(f"{parameter} takes no word")
        self.arm.effects.set(entry.slot, parameter, float(value) if isinstance(value, bool) else value)

    def _enable(self, entry: DeviceObject, *, is_enabled: bool) -> None:
        self.arm.effects.set_enabled(entry.slot, enabled=is_enabled)
        entry.is_enabled = is_enabled

    def _changed_state(self) -> None:
        self.agenda.strike_out("init")
        state = self.machine.state
        if not RENDERING[state].effects:
            for entry in self.objects.values():
                self._enable(entry, is_enabled=False)
        self._render()
        if state is State.HOME:
            self.arm.drive_to(*HOME_POSE)
        elif state is State.INIT:
            self._begin_init()

    def _render(self) -> None:
        rendering = RENDERING[self.machine.state]
        self.arm.set_render(
            powered=rendering.powered, effects=rendering.effects, force_sensor=rendering.force_sensor
        )

    def _begin_init(self) -> None:
        self.is_force_calibrated = False
        self._init_deadline = self.step + round((self.init_seconds + HOMING_PATIENCE_S) * STEP_RATE_HZ)
        for share, action in self._course_of_init():
            due = self.step + round(share * self.init_seconds * STEP_RATE_HZ)
            self.agenda.enter(max(due, self.step + 1), action, topic="init")

    def _course_of_init(self) -> Iterator[tuple[float, Callable[[], None]]]:
        """Actions of an initialisation with the share of its time at which each begins."""
        low, high = self._search_range()
        yield 0.05, self.arm.calibrate_force_sensor
        yield 0.10, lambda: self.arm.drive_to(*low)
        yield 0.30, lambda: self.arm.drive_to(*high)
        yield 0.70, lambda: self.arm.drive_to(*HOME_POSE)
        yield 1.00, self._end_init

    def _search_range(self) -> tuple[Joints, Joints]:
        """Joints between which the arm moves to find its end stops: as far as the time allows."""
        arm = self.parameters
        reach = [0.15 * self.init_seconds * speed for speed in arm.homing_speed]
        a, b, c = (max(low, -far) for low, far in zip(arm.joint_min, reach, strict=True))
        r, phi, z = (min(high, far) for high, far in zip(arm.joint_max, reach, strict=True))
        return (a, b, c), (r, phi, z)

    def _end_init(self) -> None:
        if self.init_outcome is InitOutcome.FAILS:
            self.machine.happen(Event.INIT_FAILED, "initialisation failed: no end stop found on phi")
            self._changed_state()
        elif self.init_outcome is InitOutcome.NEVER_ENDS or not self.arm.is_settled():
            self._await_home()
        else:
            self.is_force_calibrated = True
            self.machine.happen(Event.INIT_FINISHED)
            self._changed_state()

    def _await_home(self) -> None:
        if self.init_outcome is InitOutcome.NORMAL and self.step >= self._init_deadline:
            self.machine.happen(
                Event.INIT_FAILED, "initialisation failed: the arm did not reach the home pose"
            )
            self._changed_state()
        else:
            self.agenda.enter(self.step + STEP_RATE_HZ // 100, self._end_init, topic="init")
