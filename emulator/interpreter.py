"""The command language: request text in, reply text out.

Every command goes through `hm_driver.protocol.commands.parse_command`, which also words the refusals;
requests that programs repeat at the loop's rate take the short cut of `emulator.fast_requests`.
"""

from collections.abc import Callable

from emulator.device import DeviceObject, EmulatedDevice
from emulator.fast_requests import Plan, plan_request, split_brackets
from emulator.layout import (
    O_MEASURED_FORCE,
    O_MEASURED_JOINT,
    O_MEASURED_JOINT_FORCE,
    O_MEASURED_POSITION,
    O_MEASURED_VELOCITY,
    O_MODEL_ACCELERATION,
    O_MODEL_JOINT,
    O_MODEL_JOINT_ACCELERATION,
    O_MODEL_JOINT_VELOCITY,
    O_MODEL_POSITION,
    O_MODEL_VELOCITY,
)
from emulator.phrases import PhraseBook
from hm_driver.errors import ProtocolError
from hm_driver.protocol import vocabulary
from hm_driver.protocol.commands import (
    CalibrateForceSensor,
    Command,
    Create,
    Disable,
    Enable,
    GetParameter,
    GetQuantity,
    Remove,
    RemoveAll,
    SetParameter,
    SetQuantity,
    format_value,
    parse_command,
    split_request,
)
from hm_driver.protocol.framing import Dialect, encode_reply, render_value
from hm_driver.protocol.vocabulary import QUANTITIES, State, Value, Vector, error_reply

MAX_COMMANDS = 64
"""Most commands in one request (a choice)."""

_MOST_PLANS = 256

_VECTOR_QUANTITIES = {
    "measpos": O_MEASURED_POSITION,
    "measvel": O_MEASURED_VELOCITY,
    "measforce": O_MEASURED_FORCE,
    "modelpos": O_MODEL_POSITION,
    "modelvel": O_MODEL_VELOCITY,
    "modelacc": O_MODEL_ACCELERATION,
    "measposjoint": O_MEASURED_JOINT,
    "measforcejoint": O_MEASURED_JOINT_FORCE,
    "modelposjoint": O_MODEL_JOINT,
    "modelveljoint": O_MODEL_JOINT_VELOCITY,
    "modelaccjoint": O_MODEL_JOINT_ACCELERATION,
}


class Interpreter:
    """Reads commands, has the device carry them out, and words the replies.

    Args:
        device: What the commands act on.
    """

    __slots__ = ("_device", "_outputs", "_plans", "_quantities", "answered", "phrases", "refused")

    def __init__(self, device: EmulatedDevice) -> None:
        self._device = device
        self._outputs = device.outputs
        self._plans: dict[tuple[str, ...], Plan | None] = {}
        self._quantities = self._readers()
        self.phrases = PhraseBook(device, _VECTOR_QUANTITIES)
        """What a compiled client may have answered without asking here."""
        self.answered = 0
        """Requests answered."""
        self.refused = 0
        """Commands answered by an error."""

    def reply(self, request: str, dialect: Dialect) -> bytes:
        """Bytes of the reply to one request; errors are replies too, nothing is raised."""
        if dialect is Dialect.TEXT:
            return self.answer(request).encode("ascii")
        self.answered += 1
        return encode_reply(dialect, [render_value(self._carry_out(request), dialect)])

    def answer(self, request: str) -> str:
        """Reply line to a text request of one or more commands, each part closed by ``;``.

        A refused command does not keep those after it from being carried out.
        """
        self.answered += 1
        outside, brackets = split_brackets(request)
        plan = self._plans.get(outside)
        if plan is not None:
            reply = plan(brackets)
            if reply is not None:
                return reply
        parts = split_request(request)
        if len(parts) > MAX_COMMANDS:
            self.refused += 1
            return f"{error_reply(f'{len(parts)} commands in one request; accepted: {MAX_COMMANDS}')};\n"
        refused = self.refused
        replies = [format_value(self._carry_out(part)) for part in parts]
        if self.refused == refused and outside not in self._plans:
            self._prepare(outside, parts)
        return ";".join(replies) + ";\n"

    def _prepare(self, outside: tuple[str, ...], commands: list[str]) -> None:
        for command in commands:
            self.phrases.learn(command)
        if len(self._plans) >= _MOST_PLANS:
            self._plans.clear()
        self._plans[outside] = plan_request(outside, self._device, _VECTOR_QUANTITIES, self._quantities)

    def _carry_out(self, text: str) -> Value:
        try:
            return self._execute(parse_command(text))
        except ProtocolError as error:
            self.refused += 1
            return error_reply(str(error))

    def _execute(self, command: Command) -> Value:
        device = self._device
        match command:
            case GetQuantity(name):
                return self._quantities[name]()
            case SetQuantity(name, value):
                return self._set_quantity(name, value)
            case GetParameter(name, parameter):
                return self._get_parameter(device.find(name), parameter)
            case SetParameter(name, parameter, value):
                device.set_parameter(name, parameter, value)
                return device.find(name).type.parameter(parameter).reply
            case Enable(name):
                device.enable(name, is_enabled=True)
                return vocabulary.EFFECT_ENABLED
            case Disable(name):
                device.enable(name, is_enabled=False)
                return vocabulary.EFFECT_DISABLED
            case CalibrateForceSensor():
                device.calibrate_force_sensor()
                return vocabulary.FORCE_SENSOR_CALIBRATED
            case _:
                return self._change_objects(command)

    def _change_objects(self, command: Create | Remove | RemoveAll) -> str:
        self._plans.clear()
        self.phrases.forget()
        match command:
            case Create(kind, name):
                self._device.create(kind, name)
                return vocabulary.created_reply(kind, name)
            case Remove(name):
                self._device.remove(name)
            case RemoveAll():
                self._device.remove_all()
        return vocabulary.REMOVED

    def _set_quantity(self, name: str, value: Value) -> str:
        if name == "state":
            self._device.request_state(State(value))
            return vocabulary.state_reply(str(value))
        number = _number(value)
        if name == "inertia":
            self._device.arm.inertia = number
        else:
            self._device.arm.coulomb_friction = number
        return QUANTITIES[name].reply

    def _get_parameter(self, entry: DeviceObject, parameter: str) -> Value:
        if parameter == vocabulary.ENABLED.name:
            return entry.is_enabled
        description = entry.type.parameter(parameter)
        return self._device.read_parameter(entry, description)

    def _readers(self) -> dict[str, Callable[[], Value]]:
        """A function for every quantity that can be asked for."""
        device = self._device
        machine, geometry = device.machine, device.geometry
        readers: dict[str, Callable[[], Value]] = {
            name: self._vector_reader(index) for name, index in _VECTOR_QUANTITIES.items()
        }
        readers |= {
            "state": lambda: device.state.value,
            "position_calibrated": lambda: machine.position_calibrated,
            "force_calibrated": lambda: device.is_force_calibrated,
            "inertia": lambda: device.arm.inertia,
            "coulombfriction": lambda: device.arm.coulomb_friction,
            "workspace_r": lambda: (geometry.r_min, geometry.r0, geometry.r_max),
            "workspace_phi": lambda: (geometry.phi_min, 0.0, geometry.phi_max),
            "workspace_z": lambda: (geometry.z_min, 0.0, geometry.z_max),
            "os": lambda: "Linux",
            "emergencybuttonpushed": lambda: machine.emergency_button_pushed,
            "emergencyrelay": lambda: machine.has_drive_power,
        }
        return readers

    def _vector_reader(self, index: int) -> Callable[[], Vector]:
        outputs = self._outputs

        def read() -> Vector:
            return outputs[index], outputs[index + 1], outputs[index + 2]

        return read


def _number(value: Value) -> float:
    if isinstance(value, (str, tuple)):
        raise ProtocolError(f"{value!r} is no number")
    return float(value)
