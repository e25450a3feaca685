"""The compiled loop against the interpreted one: the same bytes on the wire and in the log."""

import dataclasses
import math
from functools import cache

import pytest
from mcap.reader import make_reader

from emulator.in_process import LockstepEmulator
from hm_driver.errors import HapticMasterError, SafetyTrip
from hm_driver.realtime.core import Recording
from hm_driver.realtime.modes import LimitOptions, ModeOptions, PositionControl
from hm_driver.realtime.options import LoopOptions, TimingOptions, WatchOptions
from hm_driver.realtime.setpoint import SetPoint
from hm_driver.recording.ring import Ring
from teaching.hands.simulated import DemonstratorOptions
from teaching.session import ForceFeedback, SessionOptions
from teaching.task_file import load_task
from tools.run import lockstep
from tools.run.lockstep import LockstepLoop
from tools.run.options import AccumulationOptions, TeachOptions
from tools.run.request import TeachRequest

OPTIONS = TeachOptions(
    accumulation=AccumulationOptions(N_acc=100),
    session=SessionOptions(
        practice=0.5, give_up=5.0, examination=0.5, autonomous_spacing=0.4, autonomous_speed=0.2
    ),
    demonstrator=DemonstratorOptions(examination=1.0),
)
RENDERED = dataclasses.replace(
    OPTIONS,
    session=dataclasses.replace(OPTIONS.session, force_feedback=ForceFeedback.RENDERED, give_up=3.0),
)


class Watcher:
    """A view that lets a test have its say after each tick."""

    def __init__(self, react):
        self.react = react

    def tell(self, text):
        pytest.fail(text)

    def show(self, time_s, *_):
        if self.react is not None:
            self.react(time_s)


def messages(directory, options, *, is_compiled, react=None):
    """All messages of a session's log, and what ended it."""
    request = TeachRequest(options=options, task=load_task("paper"), seed=4, output=directory)
    name = f"{'compiled' if is_compiled else 'interpreted'}"
    ended = None
    try:
        lockstep.run_lockstep(request, Watcher(react), name=name, is_compiled=is_compiled)
    except (HapticMasterError, KeyboardInterrupt) as error:
        ended = repr(error)
    with (directory / f"{name}.mcap").open("rb") as file:
        log = [
            (channel.topic, message.sequence, message.log_time, message.publish_time, message.data)
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False)
        ]
    return log, ended


def check_same(directory, options, **more):
    one, ended = messages(directory, options, is_compiled=True, **more)
    other, expected = messages(directory, options, is_compiled=False, **more)
    assert ended == expected
    assert len(one) == len(other) > 50
    for k, (message, twin) in enumerate(zip(one, other, strict=True)):
        assert message == twin, f"message {k}"
    return ended


@pytest.mark.parametrize("options", [OPTIONS, RENDERED], ids=["visual", "rendered"])
def test_a_session_has_the_same_log_compiled_and_interpreted(tmp_path, options):
    assert check_same(tmp_path, options) is None


def test_a_velocity_trip_has_the_same_log(tmp_path):
    options = dataclasses.replace(OPTIONS, limits=LimitOptions(velocity_z=0.05))
    assert "faster" in check_same(tmp_path, options)


@pytest.mark.parametrize("kind", ["force", "emergency", "silent", "interrupt"])
def test_what_ends_a_session_in_its_midst_leaves_the_same_log(tmp_path, monkeypatch, kind):
    made = []

    def make(**arguments):
        made.append(LockstepEmulator(**arguments))
        return made[-1]

    def react(time_s):
        if not math.isclose(time_s, 1.5):
            return
        if kind == "interrupt":
            raise KeyboardInterrupt
        world = made[-1].world
        if kind == "force":
            world.inject("force_bias", value=(0.0, 0.0, 100.0))
        elif kind == "emergency":
            world.inject("emergency_button")
        else:
            world.inject("frozen")

    monkeypatch.setattr(lockstep, "LockstepEmulator", make)
    assert check_same(tmp_path, OPTIONS, react=react) is not None


class Wire:
    """A loop on its own, moved along a path, with every line that it sends."""

    def __init__(self, *, is_compiled, options=None, faults=()):
        self.emulator = LockstepEmulator(seed=5, init_seconds=0.2)
        self.lines = []
        self._handle, self.emulator.handle = self.emulator.handle, self.note
        memory = bytearray(1 << 20)
        Ring.format(memory)
        self.reader = Ring(memory)
        self.loop = LockstepLoop(
            options or LoopOptions(url="sim://"),
            self.emulator,
            Recording(Ring(memory), 0),
            is_compiled=is_compiled,
        )
        self.lines.clear()
        self.faults = dict(faults)

    def note(self, data):
        self.lines.append(data)
        return self._handle(data)

    def run(self, milliseconds):
        """Every line in order, and the records of the loop."""
        loop = self.loop
        records = []
        for k in range(milliseconds):
            if k in self.faults:
                self.emulator.world.inject(**self.faults[k])
            asked = len(self.lines)
            loop.sleep_until_ns(loop.start_ns + 1_000_000 * k)
            if len(self.lines) == asked:  # answered without Python
                self.lines.append(loop._compiled.request)
            if k % 10 == 0:
                loop.publish(path(k * 1e-3))
            records += self.reader.drain()
        loop.stop()
        return self.lines, records + self.reader.drain()


def path(time_s):
    """Set-points that engage, move, release and push."""
    step = int(time_s / 0.1)
    return SetPoint(
        sequence=float(round(time_s * 1e3)),
        assist=float(step % 3 == 0),
        engage_x=float(step % 4 == 1),
        engage_y=float(step % 5 > 1),
        engage_z=float(step % 3 == 1),
        target_x=0.02 * math.sin(3.0 * time_s),
        target_y=0.02 * math.cos(3.0 * time_s) - 0.02,
        target_z=0.01 * math.sin(5.0 * time_s),
        velocity_x=0.06 * math.cos(3.0 * time_s),
        velocity_z=0.05 * math.cos(5.0 * time_s),
        bias_x=1.0 * (step % 2),
        bias_z=-2.0 * (step % 3),
    )


@cache
def interpreted(milliseconds):
    return Wire(is_compiled=False).run(milliseconds)


def test_every_line_on_the_wire_is_the_same():
    lines, records = Wire(is_compiled=True).run(1500)
    expected, their_records = interpreted(1500)
    assert len(expected) > 1500
    assert lines == expected
    assert records == their_records


def test_every_line_is_the_same_where_the_loop_renders_the_springs():
    modes = ModeOptions(position_control=PositionControl.BIAS_FORCE)
    options = LoopOptions(url="sim://", modes=modes)
    runs = [Wire(is_compiled=is_compiled, options=options).run(400) for is_compiled in (True, False)]
    assert runs[0] == runs[1]
    lines = b"".join(runs[0][0])
    assert b"set feedback force" in lines
    assert b"set spring" not in lines


@pytest.mark.parametrize("rate_hz", [400.0, 2500.0])
def test_other_rates_of_the_loop_are_the_same_too(rate_hz):
    options = LoopOptions(url="sim://", timing=TimingOptions(rate_hz=rate_hz))
    records = [Wire(is_compiled=is_compiled, options=options).run(300)[1] for is_compiled in (True, False)]
    assert records[0] == records[1]


def test_a_silent_application_trips_in_the_same_cycle():
    def run(*, is_compiled):
        wire = Wire(
            is_compiled=is_compiled, options=LoopOptions(url="sim://", watch=WatchOptions(heartbeat_s=0.03))
        )
        loop = wire.loop
        loop.sleep_until_ns(loop.start_ns)
        loop.publish(path(0.0))
        loop.sleep_until_ns(loop.start_ns + 100_000_000)
        with pytest.raises(SafetyTrip, match="silent"):
            loop.check()
        return wire.reader.drain()

    assert run(is_compiled=True) == run(is_compiled=False)


def test_a_fault_that_begins_and_ends_between_two_ticks_acts_at_its_step():
    faults = {203: {"kind": "force_bias", "value": (5.0, 0.0, 0.0), "duration_s": 0.0123}}
    records = [Wire(is_compiled=is_compiled, faults=faults).run(300)[1] for is_compiled in (True, False)]
    assert records[0] == records[1]
    assert records[0] != interpreted(300)[1]
