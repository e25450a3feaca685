"""Short sessions in lock-step, through the real emulator, protocol, loop and recorder."""

import dataclasses
import json
import math
import os
import signal
import time
from functools import cache

import numpy as np
import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader

from emulator.in_process import LockstepEmulator
from hm_driver.errors import SafetyTrip
from hm_driver.realtime.modes import LimitOptions, ModeOptions
from hm_driver.recording.reader import Recording
from hm_driver.recording.recorder import RecorderProcess
from teaching.correction import CorrectionOptions
from teaching.hands.simulated import DemonstratorOptions
from teaching.kernels import warm_up
from teaching.session import ForceFeedback, SessionOptions, Stage
from teaching.task_file import load_task, task_from_dict
from tools.config import load
from tools.config_text import to_dict, to_toml
from tools.run import lockstep
from tools.run.options import AccumulationOptions, TeachOptions
from tools.run.request import TeachRequest

OPTIONS = TeachOptions(
    accumulation=AccumulationOptions(N_acc=150),
    session=SessionOptions(
        practice=1.0, give_up=9.0, examination=1.0, autonomous_spacing=0.2, autonomous_speed=0.2
    ),
    demonstrator=DemonstratorOptions(examination=1.5),
)
TOPICS = {
    "/device/state",
    "/device/command",
    "/loop/timing",
    "/events",
    "/device/arm",
    "/device/pose",
    "/log",
    "/scene",
    "/tf",
    "/teaching/arbitration",
    "/teaching/learner",
    "/teaching/hand",
}
SEEDS = (1, 2, 3)
RATE = 0.5
"""Largest change of the commanded force [N per ms]."""
TINY = 1e-6


class Watcher:
    """A view that lets a test have its say after each tick."""

    def __init__(self, react=None, tell=None):
        self.times = []
        self.react = react
        self.tell = tell

    def show(self, time_s, session, *_):
        self.times.append(time_s)
        if self.react is not None:
            self.react(time_s, session)


def run(directory, *, seed=1, name="session", react=None, tell=None, options=OPTIONS):
    request = TeachRequest(options=options, task=load_task("paper"), seed=seed, output=directory)
    return lockstep.run_lockstep(request, Watcher(react, tell), name=name)


def messages(path):
    with path.open("rb") as file:
        return [
            (channel.topic, message.sequence, message.log_time, message.publish_time, message.data)
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False)
        ]


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Logs of short sessions by seed; each is run when it is first asked for."""
    warm_up()

    @cache
    def of(seed):
        outcome = run(tmp_path_factory.mktemp(f"seed{seed}"), seed=seed)
        assert outcome.lost == 0
        return outcome.log

    return of


@pytest.fixture
def emulators(monkeypatch):
    """The emulators that sessions make, to look at them afterwards."""
    made = []

    def make(**arguments):
        made.append(LockstepEmulator(**arguments))
        return made[-1]

    monkeypatch.setattr(lockstep, "LockstepEmulator", make)
    return made


# The log


def test_two_runs_of_one_seed_give_the_same_log_message_for_message(session, tmp_path):
    first = messages(session(1))
    second = messages(run(tmp_path, seed=1, name="again").log)
    assert len(first) == len(second) > 30_000
    for k, (one, other) in enumerate(zip(first, second, strict=True)):
        assert one == other, f"message {k}"


def test_another_seed_is_another_session(session):
    assert messages(session(1)) != messages(session(2))


def test_the_log_holds_what_the_report_needs(session):
    with Recording(session(1)) as log:
        assert set(log.topics) == TOPICS
        assert all(log.counts[topic] > 0 for topic in TOPICS)
        assert not log.damage
        assert log.start_time_ns == lockstep.EPOCH_NS
        metadata = log.metadata["session"]
        assert metadata["seed"] == "1"
        assert metadata["clock"] == "virtual"
        assert metadata["task"] == "paper"
        assert "started" not in metadata
        assert json.loads(log.attachments["config.json"]) == to_dict(OPTIONS)
        assert task_from_dict(json.loads(log.attachments["task.json"])) == load_task("paper")


def test_the_logged_configuration_can_be_loaded_again(session, tmp_path):
    with Recording(session(1)) as log:
        logged = json.loads(log.attachments["config.json"])
    path = tmp_path / "config.toml"
    path.write_text(to_toml(OPTIONS))
    assert to_dict(load(TeachOptions, path)) == logged


def test_a_tick_stands_at_every_tenth_cycle_and_sees_the_cycle_of_its_own_time(session):
    with Recording(session(1)) as log:
        state = log.columns("/device/state")
        ticks = log.columns("/teaching/arbitration")
    assert set(np.diff(state["time_ns"])) == {1_000_000}
    assert set(np.diff(ticks["time_ns"])) == {10_000_000}
    assert ticks["time_ns"][0] == state["time_ns"][0] == lockstep.EPOCH_NS
    handle = state["measured_position.x"][::10][: len(ticks["x"])]
    task = load_task("paper")
    assert ticks["x"] == pytest.approx(task.scale[0] * (handle - task.offset[0]), abs=1e-12)


def test_a_session_has_its_stages_updates_and_hand_overs_in_the_log(session):
    with Recording(session(1)) as log:
        events = log.columns("/events")
        learner = log.columns("/teaching/learner")
        ticks = log.columns("/teaching/arbitration")
    told = list(zip(events["name"], events["text"], strict=True))
    assert [text for name, text in told if name == "stage"] == ["practice", "teaching", "autonomous", "done"]
    assert sorted(set(ticks["stage"].tolist())) == [0, 1, 2, 3]
    assert sum(name == "update" for name, _ in told) == len(learner["update"]) >= 1
    assert learner["samples"].tolist() == [150 * int(n) for n in learner["update"]]
    assert ("hand-over", "the skill is in control") in told
    assert ticks["recorded"].sum() >= learner["samples"][-1]
    assert set(ticks["C"][ticks["recorded"].astype(bool)]) == {1.0}


def test_the_hand_lets_go_in_the_autonomous_run(session):
    with Recording(session(1)) as log:
        hand = log.columns("/teaching/hand")
        ticks = log.columns("/teaching/arbitration")
    alone = ticks["stage"] >= Stage.AUTONOMOUS
    assert not hand["stiffness.x"][alone].any()
    assert (hand["stiffness.x"][~alone] > 0.0).all()


def test_no_period_is_missed_on_a_virtual_clock(session):
    with Recording(session(1)) as log:
        timing = log.columns("/loop/timing")
    assert not timing["missed_periods"].any()
    assert not timing["lateness_ns"].any()


# The end


def test_after_the_session_the_device_is_stopped_and_empty(emulators, tmp_path):
    options = dataclasses.replace(
        OPTIONS, session=dataclasses.replace(OPTIONS.session, practice=0.2, give_up=0.3)
    )
    run(tmp_path, options=options)
    assert emulators[0].truth().state == "stop"
    assert emulators[0].handle(b"get spring_z stiffness\n").count(b"ERROR") == 1


def check_readable(path, *, trip):
    with Recording(path) as log:
        assert not log.damage
        assert log.counts["/device/command"] == log.counts["/device/state"] > 0
        assert ("trip." + trip in log.columns("/events")["name"]) == bool(trip)
        command = log.columns("/device/command")
    for name in ("spring_force.x", "spring_force.y", "spring_force.z", "assist_force"):
        assert command[name][-1] == 0.0


def test_a_velocity_trip_stops_the_device_and_leaves_a_complete_log(emulators, tmp_path):
    options = dataclasses.replace(OPTIONS, limits=LimitOptions(velocity_z=0.05))
    with pytest.raises(SafetyTrip) as caught:
        run(tmp_path, options=options)
    assert caught.value.reason == "velocity"
    assert emulators[0].truth().state == "stop"
    check_readable(tmp_path / "session.mcap", trip="velocity")


def test_a_force_on_the_sensor_trips_in_the_midst_of_a_session(emulators, tmp_path):
    def push(time_s, _):
        if math.isclose(time_s, 2.0):
            emulators[0].world.inject("force_bias", value=(0.0, 0.0, 100.0))

    with pytest.raises(SafetyTrip) as caught:
        run(tmp_path, react=push)
    assert caught.value.reason == "force"
    assert emulators[0].truth().state == "stop"
    check_readable(tmp_path / "session.mcap", trip="force")


def test_an_interrupt_stops_the_device_and_leaves_a_complete_log(emulators, tmp_path):
    def interrupt(time_s, _):
        if time_s > 3.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, react=interrupt)
    assert emulators[0].truth().state == "stop"
    check_readable(tmp_path / "session.mcap", trip="")


@pytest.mark.filterwarnings("ignore:.*:UserWarning")
def test_a_session_whose_recorder_is_killed_goes_on_in_another_part_and_loses_nothing(
    emulators, tmp_path, monkeypatch
):
    recorders, told = [], []
    started = RecorderProcess.launch
    monkeypatch.setattr(RecorderProcess, "launch", lambda it: (recorders.append(it), started(it)))

    def kill_recorder(time_s, _):
        if math.isclose(time_s, 0.5):
            os.kill(recorders[0].pid, signal.SIGKILL)
        if math.isclose(time_s, 0.55):
            deadline = time.monotonic() + 20.0
            while not told and time.monotonic() < deadline:
                time.sleep(0.01)

    options = dataclasses.replace(
        OPTIONS, session=dataclasses.replace(OPTIONS.session, practice=0.2, give_up=0.6)
    )
    run(tmp_path, react=kill_recorder, tell=told.append, options=options)
    assert emulators[0].truth().state == "stop"
    assert told == ["the recorder died; the log goes on in session.part2.mcap"]
    with Recording(tmp_path / "session.mcap") as log:
        assert [part.name for part in log.parts] == ["session.mcap", "session.part2.mcap"]
        times = log.columns("/device/state", names=())["log_time_ns"]
    assert (np.diff(times) == 1_000_000).all()


def test_the_user_can_begin_the_autonomous_run_from_the_view(tmp_path):
    def ask(time_s, session):
        if math.isclose(time_s, 0.5):
            session.request_autonomy()

    with Recording(run(tmp_path, react=ask).log) as log:
        ticks = log.columns("/teaching/arbitration")
    begun = np.flatnonzero(ticks["stage"] == Stage.AUTONOMOUS)[0]
    assert begun == 51


# Bumpless


@pytest.fixture(scope="module")
def corrected(tmp_path_factory):
    """Log of a session in which the human forgets, undoes and insists at any time."""
    warm_up()
    rng = np.random.default_rng(6)
    wishes = ("forget", "forget_all", "undo", "undo", "discard")

    def ask(_, session):
        if session.stage is Stage.TEACHING and rng.random() < 0.01:
            getattr(session, str(rng.choice(wishes)))()

    options = dataclasses.replace(
        OPTIONS,
        correction=CorrectionOptions(insist_force=0.5, insist_time=0.05, hold=0.2),
        session=dataclasses.replace(OPTIONS.session, flush=20, samples_per_tick=100),
    )
    path = run(tmp_path_factory.mktemp("corrected"), react=ask, options=options).log
    with Recording(path) as log:
        told = log.columns("/events")["name"].tolist()
        C = log.columns("/teaching/arbitration")["C"]
    assert {"forget", "undo", "insist"} <= set(told)
    assert np.count_nonzero(np.diff(C == 1.0)) > 4
    return path


class Motion:
    """A log of the loop, with the parts of which the commanded forces change from cycle to cycle."""

    def __init__(self, path):
        with Recording(path) as log:
            tables = log.tables({"/device/command": None, "/device/state": None})
        self.command, self.state = tables["/device/command"], tables["/device/state"]
        self.dt_s = np.diff(self.command["time_ns"]) * 1e-9
        self.dt_ms = self.dt_s * 1e3

    def handle(self, axis):
        return self.state[f"measured_position.{axis}"], self.state[f"model_velocity.{axis}"]

    def engaged(self, axis):
        phase = self.command[f"phase.{axis}"]
        return (phase[1:] > 0.0) & (phase[:-1] > 0.0)

    def owed_to_handle(self, axis, stiffness, damping):
        """Largest change [N] that the handle makes to a spring whose reference rests or goes along."""
        position, velocity = self.handle(axis)
        moved, expected = np.diff(position), velocity[1:] * self.dt_s
        away = np.maximum(np.abs(moved), np.abs(moved - expected))
        return stiffness * away + damping * np.abs(np.diff(velocity))

    def owed_to_command(self, axis, stiffness, damping):
        """Change [N] that the reference makes, for a handle at rest or moving, whichever it is less for.

        K v dt + B dv for a handle at rest, K (v - x') dt + B dv for one that moves at x': a reference that
        goes along with the handle changes no force. The difference to the change of the force as logged is
        the handle's own: a hand changes the force of a spring of 5 kN/m and 245 N*s/m by more than 0.5 N
        per ms.
        """
        velocity = self.command[f"reference_velocity.{axis}"]
        at_rest = stiffness * velocity[1:] * self.dt_s + damping * np.diff(velocity)
        moving = at_rest - stiffness * self.handle(axis)[1][1:] * self.dt_s
        return np.where(at_rest * moving <= 0.0, 0.0, np.minimum(np.abs(at_rest), np.abs(moving)))


MODES = ModeOptions()
POSITION = (MODES.position_stiffness, MODES.damping(MODES.position_stiffness, MODES.position_damping_ratio))
ASSIST = (MODES.assist_stiffness, MODES.damping(MODES.assist_stiffness, MODES.assist_damping_ratio))


@pytest.fixture(scope="module", params=[*SEEDS, "corrected"])
def motion(request, session):
    is_seed = request.param in SEEDS
    return Motion(session(request.param) if is_seed else request.getfixturevalue(request.param))


@pytest.mark.parametrize("axis", "xyz")
def test_the_command_never_changes_a_spring_faster_than_the_force_rate(motion, axis):
    engaged = motion.engaged(axis)
    assert engaged.any()
    changes = motion.owed_to_command(axis, *POSITION)
    assert (changes[engaged] <= 0.7 * RATE * motion.dt_ms[engaged] + TINY).all()


def test_spring_and_assist_together_change_by_the_force_rate_and_the_handles_own_motion(motion):
    """At every hand-over, mode change and update: the whole log is looked at, not only these moments."""
    force = motion.command["spring_force.z"] + motion.command["assist_force"]
    assert np.abs(motion.command["assist_force"]).max() > 1.0
    own = motion.owed_to_handle("z", *POSITION) + motion.owed_to_handle("z", *ASSIST)
    assert (np.abs(np.diff(force)) <= RATE * motion.dt_ms + own + TINY).all()


def test_the_commanded_force_stays_within_its_limit(motion):
    for axis in "xy":
        assert np.abs(motion.command[f"spring_force.{axis}"]).max() <= MODES.position_force_max
    force = motion.command["spring_force.z"] + motion.command["assist_force"]
    assert np.abs(force).max() <= MODES.position_force_max
    assert np.abs(motion.command["assist_force"]).max() <= MODES.assist_force_max


@pytest.mark.parametrize("axis", "xyz")
def test_a_reference_moves_no_faster_than_its_limit_and_begins_at_the_handle(motion, axis):
    limit = LimitOptions().reference_speed
    reference, phase = motion.command[f"reference.{axis}"], motion.command[f"phase.{axis}"]
    engaged = motion.engaged(axis)
    assert (np.abs(np.diff(reference))[engaged] <= limit * motion.dt_s[engaged] + TINY).all()
    begun = np.flatnonzero((phase[1:] > 0.0) & (phase[:-1] == 0.0)) + 1
    assert len(begun) > 0
    gap = np.abs(reference - motion.handle(axis)[0])[begun]
    assert (gap <= limit * 1e-3 + TINY).all()


def test_rendered_force_is_ramped_and_limited(tmp_path):
    options = dataclasses.replace(
        OPTIONS,
        session=dataclasses.replace(
            OPTIONS.session, force_feedback=ForceFeedback.RENDERED, give_up=3.0, autonomous_spacing=0.4
        ),
    )
    with Recording(run(tmp_path, options=options).log) as log:
        bias = log.columns("/device/command")["bias_force.z"]
    limits = LimitOptions()
    assert 1.0 < np.abs(bias).max() <= limits.bias_max
    assert np.abs(np.diff(bias)).max() <= limits.bias_rate * 1e-3 + TINY
    assert bias[-1] == 0.0


def test_a_viewer_finds_the_arm_the_plane_the_fields_and_the_events_in_the_log(session):
    with session(1).open("rb") as file:
        reader = make_reader(file)
        kinds = {
            channel.topic: reader.get_summary().schemas[channel.schema_id].name
            for channel in reader.get_summary().channels.values()
        }
        scenes = [
            SceneUpdate.FromString(message.data).entities[0]
            for _, _, message in reader.iter_messages(topics="/scene")
        ]
        said = [Log.FromString(message.data).name for _, _, message in reader.iter_messages(topics="/log")]
    assert {topic: kind for topic, kind in kinds.items() if kind.startswith("foxglove.")} == {
        "/device/pose": "foxglove.PoseInFrame",
        "/device/arm": "foxglove.SceneUpdate",
        "/tf": "foxglove.FrameTransform",
        "/log": "foxglove.Log",
        "/scene": "foxglove.SceneUpdate",
    }
    with Recording(session(1)) as log:
        assert said == log.columns("/events")["name"].tolist()
        models = [len(centres) // 2 for centres in log.columns("/teaching/learner")["centres"]]
    assert [len(scene.cylinders) // 2 for scene in scenes if scene.id == "receptive fields"] == models
    assert scenes[0].id == "plane"
