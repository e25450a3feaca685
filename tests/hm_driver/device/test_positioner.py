import math

import pytest

import hm_driver
from emulator.in_process import LockstepEmulator
from hm_driver.device.haptic_master import HapticMaster
from hm_driver.device.link import CommandLink
from hm_driver.device.positioner import Positioner
from hm_driver.errors import ConfigurationError, DeviceError
from hm_driver.protocol.framing import Dialect
from hm_driver.protocol.vocabulary import State
from hm_driver.transport.in_process import InProcessTransport


@pytest.fixture
def arm():
    with hm_driver.connect("sim://?init_seconds=0.1") as arm:
        arm.initialise()
        yield arm


@pytest.mark.parametrize("state", [State.POSITION, State.FORCE])
def test_the_arm_goes_where_it_is_told_and_the_spring_is_gone_afterwards(arm, state):
    x, y, z = arm.measured_position()
    with Positioner(arm, state=state) as positioner:
        positioner.move_to((x + 0.02, y, z + 0.02), speed=0.2)
        positioner.hold(0.15)
        assert arm.state is state
        assert math.dist(arm.measured_position(), positioner.reference) < 2e-3
    assert arm.state is State.STOP
    with pytest.raises(DeviceError):
        arm.is_enabled("positioner")


def test_nothing_jumps_when_the_spring_is_enabled():
    emulator = LockstepEmulator(init_seconds=0.1)
    link = CommandLink(InProcessTransport(emulator), Dialect.TEXT)
    link.ask("set state init")
    emulator.advance_to_ns(6_000_000_000)
    with Positioner(HapticMaster(link)):
        before = emulator.truth().position
        emulator.advance_to_ns(6_200_000_000)
        assert math.dist(emulator.truth().position, before) < 1e-3


def test_a_hand_does_not_push_the_arm_in_state_position():
    emulator = LockstepEmulator(init_seconds=0.1)
    link = CommandLink(InProcessTransport(emulator), Dialect.TEXT)
    link.ask("set state init")
    emulator.advance_to_ns(6_000_000_000)
    moved = {}
    nothing = (0.0, 0.0, 0.0)
    for state in (State.POSITION, State.FORCE):
        with Positioner(HapticMaster(link), state=state):
            before = emulator.truth()
            force = (0.0, 0.0, 10.0)
            emulator.world.exchange(
                {"position": nothing, "stiffness": nothing, "damping": nothing, "force": force}
            )
            emulator.advance_to_ns(int((before.time_s + 0.4) * 1e9))
            moved[state] = math.dist(emulator.truth().position, before.position)
            emulator.world.release()
    assert moved[State.POSITION] < 1.5e-3  # what structure and servo give way
    assert moved[State.FORCE] > 4e-3  # 10 N on 2 kN/m


@pytest.mark.parametrize(
    ("target", "speed", "field"),
    [
        ((0.0, 0.0, 0.5), 0.1, "target"),
        ((0.0, 0.0, math.nan), 0.1, "target"),
        ((0.0, 0.0, 0.0), 0.31, "speed"),
    ],
)
def test_what_is_out_of_reach_or_too_fast_is_refused_before_anything_moves(arm, target, speed, field):
    with Positioner(arm) as positioner:
        before = positioner.reference
        with pytest.raises(ConfigurationError) as caught:
            positioner.move_to(target, speed=speed)
        assert caught.value.field == field
        assert positioner.reference == before


def test_a_state_that_renders_no_spring_is_refused(arm):
    with pytest.raises(ConfigurationError, match="home"):
        Positioner(arm, state=State.HOME)
