"""The device, typed and blocking; usable without the driver loop.

::

    with hm_driver.connect("tcp://192.168.0.25") as arm:
        arm.initialise()
        arm.set_state(State.FORCE)
        arm.create("wall", FlatPlane(pos=(0, 0, -0.1), surface=Surface(stiffness=20e3)), enable=True)
        while arm.measured_position()[2] > -0.1:
            time.sleep(0.01)
"""

import contextlib
import logging
import time
from collections.abc import Callable
from types import TracebackType
from typing import NamedTuple, Self, TypeVar

from hm_driver.device.effects import Effect
from hm_driver.device.link import CommandLink, connect_link
from hm_driver.errors import DeviceFault, HapticMasterError, ProtocolError, TransportError
from hm_driver.geometry import ArmGeometry
from hm_driver.protocol import commands
from hm_driver.protocol.framing import Dialect
from hm_driver.protocol.replies import parse_bool, parse_number, parse_vector, parse_word, read_reply
from hm_driver.protocol.vocabulary import State, Value, Vector, check_name

_log = logging.getLogger(__name__)

_POLL_S = 0.02
_Value = TypeVar("_Value")


class Measurement(NamedTuple):
    """What `HapticMaster.measure` returns, in the device's Cartesian frame."""

    position: Vector
    """[m]."""
    velocity: Vector
    """[m/s]."""
    force: Vector
    """[N]."""


class HapticMaster:
    """A HapticMASTER, or an emulated one, behind a connection.

    As a context manager it sends ``set state stop`` when the block ends, however it ends, and then closes;
    `close` alone closes the connection and leaves the device in the state in which it is.

    Every method that asks the device raises `TransportError` when the link fails, `DeviceError` when the
    device refuses, and `ProtocolError` for an answer that is none.

    Args:
        link: A connection to the device; it belongs to this object from now on.
    """

    def __init__(self, link: CommandLink) -> None:
        self.link = link

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.safe_stop()
        except HapticMasterError:
            if error is None:
                raise
            _log.exception("%s: the arm could not be stopped; push the emergency button", self.link.url)
        finally:
            self.close()

    @property
    def dialect(self) -> Dialect:
        """The dialect that the device speaks, as named or as found; also told in the log at level info."""
        return self.link.dialect

    def close(self) -> None:
        """Close the connection and send nothing; closing again does nothing."""
        self.link.close()

    def reconnect(self) -> None:
        """Open the connection anew after it was lost; raises `TransportError` where that fails."""
        self.link.reconnect()

    def command(self, text: str) -> str:
        """Send one command of the device's own language and return its answer, without quotes and ``;``."""
        return self._ask(parse_word, text)

    # States

    @property
    def state(self) -> State:
        """The state that the device is in; asks it.

        Raises:
            ProtocolError: A state that is not known.
        """
        word = self._ask(parse_word, "get state")
        try:
            return State(word)
        except ValueError:
            known = " ".join(state.value for state in State)
            message = f"state {word[:40]!r} is unknown; known: {known}"
            raise ProtocolError(message, command="get state", received=word) from None

    def set_state(self, state: State, *, timeout_s: float = 5.0) -> None:
        """Change the state and wait until the device is in it; for `State.INIT` see `initialise`.

        Raises:
            DeviceFault: The device did not enter the state in time [s]; the text names where it is.
        """
        self.link.ask(commands.SetQuantity("state", state.value).encode())
        if state is not State.INIT:
            self._wait_for(state, f"set state {state.value}", timeout_s)

    def initialise(self, *, timeout_s: float = 30.0) -> None:
        """Calibrate the force sensor and search the end stops; the arm moves, and ends in state stop.

        Raises:
            DeviceFault: The device did not leave init in time [s], or reports a fault.
        """
        self.set_state(State.INIT)
        self._wait_for(State.STOP, "set state init", timeout_s)

    def safe_stop(self) -> None:
        """Send ``set state stop``, over a new connection where this one is lost.

        Raises:
            HapticMasterError: The device could not be told; only the emergency button is left.
        """
        try:
            self.link.ask("set state stop")
        except (TransportError, ProtocolError):
            self.link.reconnect()
            self.link.ask("set state stop")

    def calibrate_force_sensor(self) -> None:
        """Take the force that is measured now for zero; nobody may touch the handle."""
        self.link.ask("calibrateforcesensor")

    # Measurements

    def measure(self) -> Measurement:
        """Measured position, velocity and force; one exchange where the device combines, three otherwise."""
        questions = ("get measpos", "get measvel", "get measforce")
        parts = self.link.exchange_many(questions)
        return Measurement(*(read_reply(parse_vector, *pair) for pair in zip(questions, parts, strict=True)))

    def measured_position(self) -> Vector:
        """Position of the end effector [m]."""
        return self._vector("measpos")

    def measured_velocity(self) -> Vector:
        """Velocity of the end effector [m/s]."""
        return self._vector("measvel")

    def measured_force(self) -> Vector:
        """Force of the hand on the end effector [N]."""
        return self._vector("measforce")

    def model_position(self) -> Vector:
        """Position of the virtual mass [m]."""
        return self._vector("modelpos")

    def model_velocity(self) -> Vector:
        """Velocity of the virtual mass [m/s]."""
        return self._vector("modelvel")

    def model_acceleration(self) -> Vector:
        """Acceleration of the virtual mass [m/s^2]."""
        return self._vector("modelacc")

    def measured_joints(self) -> Vector:
        """Joints r [m], phi [rad], z [m]."""
        return self._vector("measposjoint")

    def measured_joint_forces(self) -> Vector:
        """Forces on the joints r [N], phi [N·m], z [N]."""
        return self._vector("measforcejoint")

    def model_joints(self) -> Vector:
        """Joints of the virtual mass r [m], phi [rad], z [m]."""
        return self._vector("modelposjoint")

    def model_joint_velocities(self) -> Vector:
        """Joint velocities of the virtual mass r [m/s], phi [rad/s], z [m/s]."""
        return self._vector("modelveljoint")

    def model_joint_accelerations(self) -> Vector:
        """Joint accelerations of the virtual mass r [m/s^2], phi [rad/s^2], z [m/s^2]."""
        return self._vector("modelaccjoint")

    def workspace(self) -> ArmGeometry:
        """Reach of the arm, as the device reports it.

        Raises:
            ConfigurationError: The limits that the device reports contradict each other.
        """
        r_min, r0, r_max = self._vector("workspace_r")
        phi_min, _, phi_max = self._vector("workspace_phi")
        z_min, _, z_max = self._vector("workspace_z")
        return ArmGeometry(
            r0=r0, r_min=r_min, r_max=r_max, phi_min=phi_min, phi_max=phi_max, z_min=z_min, z_max=z_max
        )

    def is_position_calibrated(self) -> bool:
        """Whether the end stops were found."""
        return self._bool("position_calibrated")

    def is_force_calibrated(self) -> bool:
        """Whether the force sensor was zeroed."""
        return self._bool("force_calibrated")

    def is_emergency_button_pushed(self) -> bool:
        """Whether somebody pushed the emergency button."""
        return self._bool("emergencybuttonpushed")

    def is_emergency_relay_closed(self) -> bool:
        """What the device says of its emergency relay; that true means power is our reading."""
        return self._bool("emergencyrelay")

    def os_name(self) -> str:
        """Operating system of the device."""
        return self._ask(parse_word, "get os")

    # Virtual mass

    @property
    def inertia(self) -> float:
        """Virtual mass [kg]; asks the device. Setting it tells the device, whose minimum is 2 kg."""
        return self._ask(parse_number, "get inertia")

    @inertia.setter
    def inertia(self, mass: float) -> None:
        self.link.ask(commands.SetQuantity("inertia", mass).encode())

    @property
    def coulomb_friction(self) -> float:
        """Virtual Coulomb friction [N]; asks the device. Setting it tells the device."""
        return self._ask(parse_number, "get coulombfriction")

    @coulomb_friction.setter
    def coulomb_friction(self, force: float) -> None:
        self.link.ask(commands.SetQuantity("coulombfriction", force).encode())

    # Effects and shapes

    def create(self, name: str, effect: Effect, *, enable: bool = False) -> None:
        """Create an effect or a shape, set its parameters and, if asked, enable it.

        An object whose parameters are refused is removed again.

        Raises:
            ProtocolError: The name cannot be an object's.
        """
        create, *settings = effect.commands(name)
        self.link.ask(create)
        try:
            self.link.exchange_many(settings)
            if enable:
                self.enable(name)
        except HapticMasterError:
            with contextlib.suppress(HapticMasterError):
                self.remove(name)
            raise

    def remove(self, name: str) -> None:
        """Remove an object."""
        self.link.ask(commands.Remove(_checked(name)).encode())

    def remove_all(self) -> None:
        """Remove all objects."""
        self.link.ask("remove all")

    def enable(self, name: str) -> None:
        """Render an object."""
        self.link.ask(commands.Enable(_checked(name)).encode())

    def disable(self, name: str) -> None:
        """Render an object no longer."""
        self.link.ask(commands.Disable(_checked(name)).encode())

    def is_enabled(self, name: str) -> bool:
        """Whether an object is rendered."""
        return self._ask(parse_bool, commands.GetParameter(_checked(name), "enabled").encode())

    def set_parameter(self, name: str, parameter: str, value: Value) -> None:
        """Change a parameter of an object; words and units are those of the command language."""
        self.link.ask(commands.SetParameter(_checked(name), _checked(parameter), value).encode())

    def parameter(self, name: str, parameter: str) -> Value:
        """Read a parameter of an object: number, vector, quaternion or truth value."""
        command = commands.GetParameter(_checked(name), _checked(parameter)).encode()
        return self._ask(lambda reply: commands.parse_value(parse_word(reply)), command)

    def _vector(self, quantity: str) -> Vector:
        return self._ask(parse_vector, f"get {quantity}")

    def _bool(self, quantity: str) -> bool:
        return self._ask(parse_bool, f"get {quantity}")

    def _ask(self, read: Callable[[str], _Value], command: str) -> _Value:
        return read_reply(read, command, self.link.ask(command))

    def _wait_for(self, wanted: State, told: str, timeout_s: float) -> None:
        started = time.monotonic()
        while (state := self.state) is not wanted:
            elapsed_s = time.monotonic() - started
            if state is State.FAULT or elapsed_s > timeout_s:
                raise DeviceFault(
                    f"the device is in state '{state.value}' {elapsed_s:.1f} s after '{told}', not in "
                    f"'{wanted.value}' ({timeout_s:g} s are allowed); look at the emergency button "
                    "and for obstacles in the arm's way"
                )
            time.sleep(_POLL_S)


def connect(url: str, *, timeout_s: float = 1.0) -> HapticMaster:
    """Connect to a HapticMASTER: ``tcp://HOST[:PORT][?dialect=auto|text|framed]``.

    Args:
        url: Where the device is; schemes are those of `hm_driver.transport.urls`.
        timeout_s: Longest wait for the connection and for each reply [s].

    Raises:
        ConfigurationError: The URL is wrong.
        TransportError: Nothing listens there.
        ProtocolError: What listens there is no HapticMASTER.
    """
    return HapticMaster(connect_link(url, timeout_s=timeout_s))


def _checked(name: str) -> str:
    check_name(name)
    return name
