import pytest

import hm_driver
from emulator.in_process import LockstepEmulator, WallClockPeer
from hm_driver.device import effects
from hm_driver.device.haptic_master import HapticMaster
from hm_driver.device.link import CommandLink
from hm_driver.errors import (
    ConfigurationError,
    DeviceError,
    DeviceFault,
    ProtocolError,
    TransportError,
    TransportTimeout,
)
from hm_driver.geometry import ArmGeometry
from hm_driver.protocol.framing import Dialect
from hm_driver.protocol.vocabulary import OBJECT_TYPES, State
from hm_driver.transport.in_process import InProcessTransport

EFFECTS = (
    effects.Spring(
        pos=(0.0, 0.0, 0.1),
        vel=(0.0, 0.0, 0.01),
        att=(0.0, 0.0, 0.0, 1.0),
        stiffness=500.0,
        dampfactor=0.7,
        deadband=0.001,
        direction=(0.0, 0.0, 1.0),
        maxforce=30.0,
        dampglobal=True,
    ),
    effects.Damper(dampcoef=(10.0, 20.0, 30.0)),
    effects.BiasForce(force=(0.0, 1.25, 0.0)),
    effects.Shaker(
        frequency1=2.0,
        frequency2=5.0,
        direction=(1.0, 0.0, 0.0),
        posmax=0.01,
        velmax=0.2,
        accmax=5.0,
        stiffness=1000.0,
        dampfactor=1.0,
        deadband=0.0,
        maxforce=20.0,
    ),
    effects.Block(size=(0.1, 0.2, 0.3), surface=effects.Surface(stiffness=20e3, no_pull=True, friction=0.3)),
    effects.Sphere(radius=0.05, surface=effects.Surface(dampfactor=0.5, tang_damping=3.0, powermax=50.0)),
    effects.FlatPlane(normal=(0.0, 0.0, 1.0), surface=effects.Surface(ejection_velmax=0.2)),
    effects.Cylinder(radius=0.05, length=0.3, surface=effects.Surface(ejection_damping=50.0)),
    effects.Torus(
        ringradius=0.1, tuberadius=0.02, surface=effects.Surface(outward_forcemax=90.0, damping_forcemax=20.0)
    ),
)


@pytest.fixture(params=["text", "framed"])
def arm(request):
    with hm_driver.connect(f"sim://?init_seconds=0.1&dialect={request.param}") as arm:
        yield arm


class LossyPeer:
    """An emulator behind a link whose next replies can be lost."""

    def __init__(self):
        self.peer = WallClockPeer(LockstepEmulator(init_seconds=0.1))
        self.lost = 0

    def handle(self, data):
        if self.lost:
            self.lost -= 1
            return b""
        return self.peer.handle(data)

    def open(self):
        return InProcessTransport(self)


@pytest.fixture
def lossy():
    return LossyPeer()


@pytest.fixture
def lossy_arm(lossy):
    return HapticMaster(CommandLink(lossy.open(), Dialect.TEXT, reopen=lossy.open))


def test_the_arm_initialises_and_ends_in_stop(arm):
    arm.initialise()
    assert arm.state is State.STOP
    assert arm.is_position_calibrated()
    assert arm.is_force_calibrated()


def test_an_arm_that_never_leaves_init_is_a_fault_that_names_state_and_time():
    with (
        hm_driver.connect("sim://?init_seconds=600") as arm,
        pytest.raises(DeviceFault, match=r"state 'init' 0\.\d s after 'set state init'.*0\.1 s are allowed"),
    ):
        arm.initialise(timeout_s=0.1)


@pytest.mark.parametrize("state", [State.FORCE, State.POSITION, State.STOP])
def test_a_state_is_entered_before_the_call_returns(arm, state):
    arm.initialise()
    arm.set_state(state)
    assert arm.state is state


def test_a_state_that_is_refused_is_an_error_with_command_and_reply(arm):
    with pytest.raises(DeviceError) as caught:
        arm.set_state(State.FORCE)
    assert caught.value.command == "set state force"
    assert "ERROR" in caught.value.reply


def test_measurements_are_vectors_in_si_units(arm):
    arm.initialise()
    reach = ArmGeometry()
    for position in (arm.measured_position(), arm.model_position(), arm.measure().position):
        assert reach.violation(*position) is None
    readings = (
        arm.measured_velocity(),
        arm.measured_force(),
        arm.model_velocity(),
        arm.model_acceleration(),
        arm.measured_joints(),
        arm.measured_joint_forces(),
        arm.model_joints(),
        arm.model_joint_velocities(),
        arm.model_joint_accelerations(),
    )
    assert all(len(reading) == 3 for reading in readings)


def test_a_combined_measurement_takes_one_message():
    with hm_driver.connect("sim://") as arm:
        assert arm.link.probe_combined()
        before = arm.link.statistics.sent_messages
        arm.measure()
        assert arm.link.statistics.sent_messages == before + 1


def test_the_workspace_is_the_arms_geometry(arm):
    assert arm.workspace() == ArmGeometry()


def test_the_device_tells_of_itself(arm):
    assert arm.os_name() == "Linux"
    assert not arm.is_emergency_button_pushed()
    assert arm.is_emergency_relay_closed()


def test_inertia_and_friction_are_set_and_read(arm):
    arm.inertia = 3.5
    arm.coulomb_friction = 0.5
    assert (arm.inertia, arm.coulomb_friction) == (3.5, 0.5)


def test_a_virtual_mass_below_the_devices_minimum_is_refused_by_the_device(arm):
    with pytest.raises(DeviceError, match="2 to"):
        arm.inertia = 1.0


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.type_name)
def test_every_value_of_an_effect_reads_back_as_it_was_set(arm, effect):
    arm.create("thing", effect)
    assert not arm.is_enabled("thing")
    for name, value in effect.settings():
        assert arm.parameter("thing", name) == value


def test_every_type_and_every_parameter_is_covered_by_the_effects_above():
    set_here = {(effect.type_name, name) for effect in EFFECTS for name, _ in effect.settings()}
    shape_parameters = {name for kind, name in set_here if OBJECT_TYPES[kind].is_shape}
    for kind in OBJECT_TYPES.values():
        own = set(kind.parameters) - {"pos", "vel", "att"}
        assert own <= {name for type_name, name in set_here if type_name == kind.name} | shape_parameters


def test_objects_are_enabled_disabled_and_removed(arm):
    arm.create("a", effects.BiasForce(), enable=True)
    arm.create("b", effects.BiasForce())
    arm.enable("b")
    arm.disable("a")
    assert (arm.is_enabled("a"), arm.is_enabled("b")) == (False, True)
    arm.remove("a")
    with pytest.raises(DeviceError, match="'a'"):
        arm.is_enabled("a")
    arm.remove_all()
    with pytest.raises(DeviceError, match="'b'"):
        arm.is_enabled("b")


def test_a_parameter_is_changed_by_its_name(arm):
    arm.create("guide", effects.Spring())
    arm.set_parameter("guide", "stiffness", 250.0)
    assert arm.parameter("guide", "stiffness") == 250.0


def test_an_object_whose_values_are_refused_is_not_left_behind(arm):
    with pytest.raises(DeviceError, match="stiffness"):
        arm.create("guide", effects.Spring(stiffness=1e12))
    with pytest.raises(DeviceError):
        arm.is_enabled("guide")


@pytest.mark.parametrize("name", ["a; set state force", "a b", "", "all", "state", "x" * 65])
def test_a_name_that_means_something_else_never_leaves_the_house(arm, name):
    sent = arm.link.statistics.sent_messages
    for call in (arm.remove, arm.enable, arm.disable, arm.is_enabled):
        with pytest.raises(ProtocolError):
            call(name)
    assert arm.link.statistics.sent_messages == sent


def test_a_raw_command_is_answered_without_quotes(arm):
    assert arm.command("get os") == "Linux"
    assert arm.command("set inertia 3") == "Inertia set"


def test_the_end_of_the_block_stops_the_arm_and_closes_the_link(lossy, lossy_arm):
    with lossy_arm as arm:
        arm.initialise()
        arm.set_state(State.FORCE)
    assert arm.link.is_broken
    assert lossy.peer.handle(b"get state\n") == b"stop;\n"


def test_an_error_in_the_block_stops_the_arm_and_goes_on(lossy, lossy_arm):
    def fail_in_state_force():
        with lossy_arm as arm:
            arm.initialise()
            arm.set_state(State.FORCE)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_in_state_force()
    assert lossy.peer.handle(b"get state\n") == b"stop;\n"


def test_an_arm_whose_link_was_lost_is_stopped_over_a_new_one(lossy, lossy_arm):
    def lose_a_reply():
        with lossy_arm as arm:
            arm.initialise()
            arm.set_state(State.FORCE)
            lossy.lost = 1
            arm.measured_position()

    with pytest.raises(TransportTimeout):
        lose_a_reply()
    assert lossy.peer.handle(b"get state\n") == b"stop;\n"


def test_an_arm_that_cannot_be_stopped_is_an_error_of_the_block(lossy, lossy_arm):
    def lose_the_stop():
        with lossy_arm:
            lossy.lost = 2

    with pytest.raises(TransportError):
        lose_the_stop()


def test_an_arm_that_cannot_be_stopped_is_logged_when_the_block_failed(lossy, lossy_arm, caplog):
    def fail_with_a_dead_link():
        with lossy_arm:
            lossy.lost = 2
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_with_a_dead_link()
    assert "push the emergency button" in caplog.text


def test_closing_alone_leaves_the_state_as_it_is(lossy, lossy_arm):
    lossy_arm.initialise()
    lossy_arm.set_state(State.FORCE)
    lossy_arm.close()
    lossy_arm.close()
    assert lossy.peer.handle(b"get state\n") == b"force;\n"


def test_an_unknown_state_is_refused():
    class Odd:
        def handle(self, _data):
            return b"dancing;\n"

    arm = HapticMaster(CommandLink(InProcessTransport(Odd()), Dialect.TEXT))
    with pytest.raises(ProtocolError, match=r"dancing.*off init stop"):
        _ = arm.state


def test_contradictory_limits_of_the_device_are_refused():
    class Odd:
        def handle(self, _data):
            return b"[1,0.45,-1];\n"

    arm = HapticMaster(CommandLink(InProcessTransport(Odd()), Dialect.TEXT))
    with pytest.raises(ConfigurationError):
        arm.workspace()


def test_the_package_offers_what_it_promises():
    for name in hm_driver.__all__:
        assert getattr(hm_driver, name)
    with pytest.raises(AttributeError, match="it offers"):
        _ = hm_driver.nothing_of_the_kind
