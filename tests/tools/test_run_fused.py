"""The fused session against the one in lock-step, which writes and reads every line of the protocol."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.compilation import interpreted
from emulator.in_process import LockstepEmulator
from emulator.world import WorldError
from hm_driver.errors import SafetyTrip
from hm_driver.realtime.core import Recording
from hm_driver.realtime.modes import LimitOptions, ModeOptions, PositionControl
from hm_driver.realtime.options import LoopOptions, TimingOptions
from hm_driver.recording.ring import Ring
from teaching.hands.contract import HandIntent
from teaching.hands.simulated import DemonstratorOptions
from teaching.session import ForceFeedback, SessionOptions, Stage
from teaching.task_file import load_task
from tools.run.demonstrator import build_demonstrator
from tools.run.fused import INIT_S, FusedLoop, NoView, run_fused
from tools.run.fused_kernels import round_quickly
from tools.run.hands import EmulatedWorld
from tools.run.lockstep import LockstepLoop
from tools.run.options import AccumulationOptions, TeachOptions, build_session, load_options
from tools.run.request import TeachRequest
from tools.run.runner import Plugs, run_ticks

OPTIONS = TeachOptions(
    accumulation=AccumulationOptions(N_acc=150),
    session=SessionOptions(
        practice=0.5, give_up=9.0, examination=0.5, autonomous_spacing=0.4, autonomous_speed=0.2
    ),
    demonstrator=DemonstratorOptions(examination=1.0),
)
SEEDS = {"paper": (1, 2, 3), "confident": (1, 2), "turned": (1, 2)}
HASTY = DemonstratorOptions(examination=1.0)
RENDERED = dataclasses.replace(OPTIONS.session, force_feedback=ForceFeedback.RENDERED)
BY_FORCE = ModeOptions(position_control=PositionControl.BIAS_FORCE, position_stiffness=1000.0)
METHODS = ("paper", "confident", "error", "success", "button")
VARIANTS = {
    "steep": {"task": "steep"},
    "turned": {"task": "turned", "demonstrator": DemonstratorOptions(practised=False, lag=0.3)},
    "rendered": {"session": RENDERED},
    "slow loop": {"timing": TimingOptions(rate_hz=400.0)},
    "fast loop": {"timing": TimingOptions(rate_hz=2500.0)},
    "by force": {"modes": BY_FORCE},
}


class Notes:
    """A log of all that the session decided; empties the ring behind it."""

    def __init__(self, ring=None):
        self.ticks = []
        self.skills = []
        self.ring = ring

    def tick(self, time_ns, tick):
        if self.ring is not None:
            self.ring.drain()
        if tick.update is not None:
            learner = tick.update.learner
            self.skills.append((time_ns, learner.n_samples, [part.tobytes() for part in learner.models]))
        self.ticks.append(tick._replace(update=None))

    def hand(self, *_):
        pass


def request_of(options, seed, tmp_path):
    return TeachRequest(options=options, task=load_task(options.task), seed=seed, output=tmp_path)


def loop_options_of(options):
    return LoopOptions(
        url="sim://",
        modes=options.modes,
        limits=options.limits,
        geometry=options.geometry,
        timing=options.timing,
        watch=options.watch,
    )


def in_lockstep(request):
    """What `tools.run.lockstep.run_lockstep` decides, without its recorder."""
    shuffle, hand_rng, emulator_seed = request.streams()
    memory = bytearray(1 << 20)
    Ring.format(memory)
    emulator = LockstepEmulator(seed=emulator_seed, init_seconds=INIT_S)
    loop = LockstepLoop(loop_options_of(request.options), emulator, Recording(Ring(memory), 0))
    handle = emulator.truth().position
    hand = build_demonstrator(request.task, request.options.demonstrator, hand_rng, handle=handle)
    session = build_session(request.options, request.task, shuffle)
    notes = Notes(Ring(memory))
    plugs = Plugs(
        clock=loop, loop=loop, hand=hand, world=EmulatedWorld(emulator.world), log=notes, view=NoView()
    )
    try:
        run_ticks(session, plugs, start_ns=loop.start_ns, epoch_ns=0)
    except SafetyTrip as trip:
        return notes, session, str(trip)
    return notes, session, None


def fused(request):
    notes = Notes()
    try:
        return notes, run_fused(request, notes), None
    except SafetyTrip as trip:
        return notes, None, str(trip)


def options_of(name):
    if name in METHODS:
        chosen = load_options(overrides={"method": name}).value
        flush = chosen.session.flush or (30 if name == "success" else 0)  # its hand-overs come before 100
        session = dataclasses.replace(
            chosen.session, practice=0.5, give_up=9.0, examination=0.5, autonomous_spacing=0.4, flush=flush
        )
        return dataclasses.replace(
            chosen, session=session, accumulation=AccumulationOptions(N_acc=60), demonstrator=HASTY
        )
    return dataclasses.replace(OPTIONS, **VARIANTS[name])


@pytest.mark.parametrize(
    ("name", "seed"), [(name, seed) for name in (*METHODS, *VARIANTS) for seed in SEEDS.get(name, (1,))]
)
def test_a_fused_session_decides_as_the_one_in_lockstep(tmp_path, name, seed):
    request = request_of(options_of(name), seed, tmp_path)
    notes, session, ended = fused(request)
    expected, theirs, their_end = in_lockstep(request)
    assert ended is None
    assert their_end is None
    assert session.stage is Stage.DONE
    assert len(expected.ticks) > 900
    assert expected.skills, "nothing was learned: nothing was compared"
    for k, (tick, twin) in enumerate(zip(notes.ticks, expected.ticks, strict=True)):
        assert tick == twin, f"tick {k}"
    assert notes.skills == expected.skills
    assert session.hand_overs == theirs.hand_overs


@pytest.mark.parametrize(
    "limits", [LimitOptions(velocity_z=0.05), LimitOptions(force_trip=15.0)], ids=["velocity", "force"]
)
def test_a_trip_ends_a_fused_session_in_the_same_tick(tmp_path, limits):
    request = request_of(dataclasses.replace(OPTIONS, limits=limits), 1, tmp_path)
    notes, _, ended = fused(request)
    expected, _, their_end = in_lockstep(request)
    assert ended is not None
    assert ended == their_end
    assert notes.ticks == expected.ticks


def test_a_fault_of_the_device_hands_over_to_the_interpreted_loop():
    emulator = LockstepEmulator(seed=1, init_seconds=0.2)
    loop = FusedLoop(LoopOptions(url="sim://"), emulator)
    loop.sleep_until_ns(loop.start_ns + 50_000_000)
    assert loop.is_fused
    emulator.world.inject("emergency_button")
    loop._look_around()
    loop.sleep_until_ns(loop.start_ns + 100_000_000)
    assert not loop.is_fused
    with pytest.raises(SafetyTrip, match="emergency"):
        loop.check()


def test_a_hand_out_of_range_is_refused_as_by_the_world_endpoint():
    loop = FusedLoop(LoopOptions(url="sim://"), LockstepEmulator(seed=1, init_seconds=0.2))
    here, still = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    loop.move(0, HandIntent(here, still, (math.nan, 0.0, 0.0), still))
    with pytest.raises(WorldError, match="stiffness"):
        loop.sleep_until_ns(loop.start_ns)


@given(
    st.floats(allow_nan=False, allow_infinity=False)
    | st.builds(
        lambda digits, half, exponent: float(f"{digits}{half}e{exponent}"),
        st.integers(-(10**7), 10**7),
        st.sampled_from(["", ".5", ".49999999", ".50000001"]),
        st.integers(-20, 6),
    )
)
def test_the_quick_rounding_is_that_of_the_wire(x):
    assert interpreted(round_quickly)(x) == float(f"{x:.6g}") or 0.0 < abs(x) < 1e-250 or abs(x) > 1e250
