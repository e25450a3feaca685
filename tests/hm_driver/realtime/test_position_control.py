"""Position mode and state ``position`` on the emulated arm, on a virtual clock."""

import re

import pytest

from emulator.in_process import LockstepEmulator
from hm_driver.device.link import CommandLink
from hm_driver.errors import ConfigurationError
from hm_driver.protocol.framing import Dialect
from hm_driver.realtime import bring_up
from hm_driver.realtime.clock import VirtualClock
from hm_driver.realtime.core import LoopCore
from hm_driver.realtime.grid import Grid
from hm_driver.realtime.modes import ModeOptions, PositionControl
from hm_driver.realtime.options import LoopOptions, TimingOptions
from hm_driver.realtime.segment import Segment, Trip
from hm_driver.realtime.setpoint import SetPoint
from hm_driver.transport.in_process import InProcessTransport

MS = 1_000_000
BIAS = re.compile(rb"set feedback force \[([^]]*)\]")


class Rig:
    """The loop on the emulated arm, with every request that it sends."""

    def __init__(self, **options):
        self.options = LoopOptions(url="sim://", **options)
        self.emulator = LockstepEmulator(seed=2, init_seconds=0.2)
        self.requests = []
        self._handle, self.emulator.handle = self.emulator.handle, self.note
        clock = VirtualClock()
        clock.on_advance(self.emulator.advance_to_ns)
        self.link = CommandLink(InProcessTransport(self.emulator), Dialect.TEXT)
        self.link.probe_combined()
        bring_up.initialise(self.link, clock, timeout_s=30.0)
        bring_up.enter_session(self.link, self.options)
        self.segment = Segment.in_memory()
        self.core = LoopCore(
            self.link,
            Grid(clock, MS, start_ns=clock.now_ns() + MS),
            clock,
            self.segment,
            parameters=self.options.parameters(),
            watch=self.options.watch,
            keeps_timing=False,
            session_state=self.options.state,
        )
        self.ticks = 0

    def note(self, data):
        self.requests.append(data)
        return self._handle(data)

    def run(self, milliseconds, **values):
        for k in range(milliseconds):
            if k % 10 == 0:
                self.ticks += 1
                self.segment.publish(SetPoint(sequence=float(self.ticks), **values))
            assert self.core.run_cycle()
        assert self.segment.trip is Trip.NONE
        return self.segment.state()

    def push(self, force_z):
        """Let a hand without stiffness push [N]."""
        nothing = (0.0, 0.0, 0.0)
        self.emulator.world.exchange(
            {"position": nothing, "stiffness": nothing, "damping": nothing, "force": (0.0, 0.0, force_z)}
        )

    def biases(self):
        """The bias force in z that the device was told, request by request [N]."""
        told = [0.0]
        for request in self.requests:
            found = BIAS.search(request)
            told.append(float(found[1].split(b",")[2]) if found else told[-1])
        return told


@pytest.mark.parametrize("way", list(PositionControl))
def test_position_mode_brings_the_arm_to_its_target_and_holds_it(way):
    rig = Rig(modes=ModeOptions(position_control=way))
    target = rig.run(1).measured_z + 0.03
    state = rig.run(800, engage_z=1.0, target_z=target)
    assert state.measured_z == pytest.approx(target, abs=5e-4)
    assert abs(state.velocity_z) < 2e-3


def test_the_arm_moves_alike_in_both_ways():
    ends = []
    for way in PositionControl:
        rig = Rig(modes=ModeOptions(position_control=way))
        start = rig.run(1).measured_z
        rig.push(5.0)
        ends.append(rig.run(150, engage_z=1.0, target_z=start + 0.02).measured_z - start)
    assert ends[0] == pytest.approx(ends[1], abs=5e-4)


def test_a_bias_force_is_switched_by_at_most_half_a_newton_a_millisecond():
    """Beyond what the handle's own motion changes in a force K (r - x) + B (v - x')."""
    modes = ModeOptions(position_control=PositionControl.BIAS_FORCE)
    stiffness, damping = 5000.0, modes.damping(5000.0, 1.0)
    rig = Rig(modes=modes)
    before = rig.run(1)
    start, largest = before.measured_z, 0.0
    for target in (0.03, -0.03, 0.0):
        for engage in (1.0, 0.0):
            for _ in range(90):
                state = rig.run(1, engage_z=engage, target_z=start + target)
                change = state.spring_z - before.spring_z
                reaction = stiffness * (before.measured_z - state.measured_z)
                reaction += damping * (before.velocity_z - state.velocity_z)
                assert min(abs(change), abs(change - reaction)) <= 0.5
                largest, before = max(largest, abs(state.spring_z)), state
    assert largest > 3.0
    assert rig.biases()[-1] == 0.0


def test_a_hand_that_lets_go_suddenly_does_not_make_the_bias_force_swing():
    """A force whose every change were held to the rate would brake too late, and swing ever further."""
    rig = Rig(modes=ModeOptions(position_control=PositionControl.BIAS_FORCE))
    start = rig.run(1).measured_z
    rig.run(200, engage_z=1.0, target_z=start)
    rig.push(-25.0)
    assert rig.run(300, engage_z=1.0, target_z=start).measured_z < start - 0.003
    rig.emulator.world.release()
    highest = max(rig.run(10, engage_z=1.0, target_z=start).measured_z for _ in range(30))
    assert highest < start + 1e-3


def test_with_the_bias_force_the_device_s_position_springs_stay_disabled():
    rig = Rig(modes=ModeOptions(position_control=PositionControl.BIAS_FORCE))
    rig.requests.clear()
    rig.run(50, engage_x=1.0, engage_z=1.0, target_z=0.01)
    assert not [request for request in rig.requests if b"set spring" in request]


def test_in_state_position_the_springs_move_the_arm_and_a_hand_does_not():
    rig = Rig(state="position")
    start = rig.run(20).measured_z
    rig.push(20.0)
    assert rig.run(200).measured_z == pytest.approx(start, abs=2e-3)
    state = rig.run(800, engage_z=1.0, target_z=start + 0.03)
    assert state.measured_z == pytest.approx(start + 0.03, abs=2e-3)
    assert rig.link.ask("get state") == "position"


def test_a_state_in_which_no_loop_can_run_is_refused():
    with pytest.raises(ConfigurationError, match="force, position"):
        LoopOptions(url="sim://", state="home")


def test_the_loop_s_rate_decides_on_the_gains_of_a_bias_force():
    with pytest.raises(ConfigurationError, match=r"modes\.position_stiffness: .*100 Hz"):
        LoopOptions(
            url="sim://",
            modes=ModeOptions(position_control=PositionControl.BIAS_FORCE),
            timing=TimingOptions(rate_hz=100.0),
        )
