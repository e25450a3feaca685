"""A log to report on: the session's own code on a crude arm, without device, emulator or processes."""

import dataclasses
import json
from enum import Enum

import numpy as np
import pytest

from hm_driver.realtime.setpoint import LoopState
from hm_driver.recording.ring import Ring, WhenFull
from hm_driver.recording.schemas import DEVICE_CHANNELS, LOOP_BUNDLE
from hm_driver.recording.spooler import Spooler
from hm_driver.recording.writer import Attachment, LogWriter
from teaching.messages import CHANNELS
from teaching.session import SessionOptions, Stage
from teaching.task_file import load_task
from tools.run.demonstrator import build_demonstrator
from tools.run.log import SessionLog
from tools.run.options import AccumulationOptions, TeachOptions, build_session

EPOCH_NS = 1_800_000_000_000_000_000
MASS, SPRING = 3.0, 5000.0
SHORT = TeachOptions(
    accumulation=AccumulationOptions(N_acc=200),
    session=SessionOptions(practice=1.0, give_up=14.0, autonomous_spacing=0.06, autonomous_speed=0.3),
)


class Arm:
    """A mass that a hand and, where engaged, position springs pull; one cycle is a millisecond."""

    def __init__(self, position):
        self.p, self.v, self.f = list(position), [0.0] * 3, [0.0] * 3
        self.reference, self.spring_force = list(position), [0.0] * 3

    def cycle(self, intent, set_point, dt=1e-3):
        engaged = (set_point.engage_x, set_point.engage_y, set_point.engage_z) if set_point else (0.0,) * 3
        targets = (set_point.target_x, set_point.target_y, set_point.target_z) if set_point else self.p
        for axis in range(3):
            hand = 0.0
            if intent is not None:
                hand = intent.stiffness[axis] * (intent.position[axis] - self.p[axis])
                hand += intent.damping[axis] * (intent.velocity[axis] - self.v[axis])
            spring = 0.0
            if engaged[axis]:
                self.reference[axis] += (targets[axis] - self.reference[axis]) * dt / 0.03
                damping = 2.0 * (SPRING * MASS) ** 0.5
                spring = SPRING * (self.reference[axis] - self.p[axis]) - damping * self.v[axis]
                spring = min(30.0, max(-30.0, spring))
            else:
                self.reference[axis] = self.p[axis]
            self.f[axis], self.spring_force[axis] = hand, spring
            self.v[axis] += (hand + spring - 2.0 * self.v[axis]) / MASS * dt
            self.p[axis] += self.v[axis] * dt
        return engaged


def loop_values(arm, cycle, time_ns, engaged, rng):
    late = int(rng.gamma(2.0, 9e3)) + (400_000 if cycle % 9000 == 0 else 0)
    state = [cycle, time_ns, *arm.p, *arm.v, *arm.f]
    command = [
        cycle,
        time_ns,
        *arm.reference,
        *([0.0] * 3),
        *arm.spring_force,
        *engaged,
        arm.p[2],
        0.0,
        *([0.0] * 3),
    ]
    return state + command + [cycle, time_ns, late, 180_000, 90_000, late + 180_000, cycle // 50_000, 1e-3, 0]


def plain(value):
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    return value.value if isinstance(value, Enum) else value


def write_log(path, *, options=None, seed=1, stop_s=1e9, finish=True):
    """Write the log of a session that ends by itself or after stop_s seconds."""
    options = options or TeachOptions()
    task = load_task(options.task)
    rng = np.random.default_rng(seed)
    start = (task.offset[0], task.offset[1], task.handle_z(-0.01))
    session = build_session(options, task, rng)
    hand = build_demonstrator(task, options.demonstrator, rng, handle=start)
    memory = bytearray(1 << 20)
    Ring.format(memory)
    ring = Ring(memory, when_full=WhenFull.BLOCK)
    writer = LogWriter(
        path,
        (*DEVICE_CHANNELS, *CHANNELS),
        metadata={"session": {"version": "0.1.0", "seed": str(seed), "device": "synthetic", "clock": "wall"}},
        attachments=[
            Attachment(
                "config.json", "application/json", json.dumps(plain(dataclasses.asdict(options))).encode()
            ),
            Attachment("task.json", "application/json", json.dumps(task.to_dict()).encode()),
        ],
    )
    spooler = Spooler([Ring(memory)], writer, [LOOP_BUNDLE])
    log = SessionLog(ring, reference_force=task.reference_force)
    arm, intent, set_point, cycle = Arm(start), None, None, 0
    while session.stage is not Stage.DONE and cycle * 1e-3 < stop_s:
        for _ in range(10):
            time_ns = EPOCH_NS + cycle * 1_000_000
            engaged = arm.cycle(intent, set_point)
            ring.write(
                LOOP_BUNDLE.id, time_ns, LOOP_BUNDLE.pack(*loop_values(arm, cycle, time_ns, engaged, rng))
            )
            cycle += 1
            if cycle % 10 == 1:
                parts = zip("xyz", arm.p, arm.v, arm.f, strict=True)
                values = {
                    name: value
                    for axis, p, v, f in parts
                    for name, value in (
                        (f"measured_{axis}", p),
                        (f"velocity_{axis}", v),
                        (f"force_{axis}", f),
                    )
                }
                tick = session.tick(LoopState(**values), 0.01)
                set_point = tick.set_point
                intent = hand.step(tick.seen, 0.01)
                log.tick(time_ns, tick)
        spooler.spool()
    if finish:
        writer.finish()
    else:
        writer.sync()
        writer.abandon()
    return path


@pytest.fixture(scope="session")
def short_options():
    """Options of a session that is over within half a minute."""
    return SHORT


@pytest.fixture(scope="session")
def write_session():
    """A function that writes the log of a synthetic session."""
    return write_log


@pytest.fixture(scope="session")
def short_log(tmp_path_factory):
    """A short session with a few updates and an autonomous run."""
    return write_log(tmp_path_factory.mktemp("session") / "short.mcap", options=SHORT)
