"""A log of a mass that springs of known stiffness hold, and a hand moves."""

import json
import math

import numpy as np

from hm_driver.recording.schemas import (
    DEVICE_CHANNELS,
    DEVICE_COMMAND,
    DEVICE_COMMAND_CHANNEL,
    DEVICE_STATE,
    DEVICE_STATE_CHANNEL,
    LOOP_TIMING,
    LOOP_TIMING_CHANNEL,
)
from hm_driver.recording.writer import Attachment, LogWriter

MASS, STIFFNESS, DAMPING = 3.0, 2000.0, 120.0
FREE_DAMPING = 5.0
MODES = {
    "inertia": MASS,
    "position_stiffness": STIFFNESS,
    "position_damping_ratio": DAMPING / (2.0 * (STIFFNESS * MASS) ** 0.5),
    "position_force_max": 1000.0,
    "assist_stiffness": 300.0,
    "assist_damping_ratio": 0.7,
    "assist_force_max": 10.0,
}
STEPS = 5


def push(t):
    """Force of the hand [N]."""
    return 8.0 * math.sin(2.0 * math.pi * 1.3 * t) + 4.0 * math.sin(2.0 * math.pi * 3.1 * t)


def write(path, *, seconds=12.0, modes=MODES, noise=0.02, lost=range(0), release=0.5, late=None, seed=3):
    """The hand pushes sinusoids at x; the spring in x holds until `release` of the time, then x is free.

    Args:
        path: The log.
        seconds: Its duration.
        modes: Modes of the configuration; none without.
        noise: Of the measured force [N].
        lost: Cycles that are not logged.
        release: Share of the time in which the spring is engaged.
        late: Lateness of a cycle [ns] by its number.
        seed: Of the noise.
    """
    rng = np.random.default_rng(seed)
    data = json.dumps({"modes": modes} if modes else {}).encode()
    config = Attachment(name="config.json", media_type="application/json", data=data)
    x = v = 0.0
    missed = 0
    with LogWriter(path, DEVICE_CHANNELS, attachments=[config]) as writer:
        for cycle in range(round(seconds * 1000)):
            time_ns = cycle * 1_000_000
            t = cycle * 1e-3
            engaged = t < release * seconds
            spring = -STIFFNESS * x - DAMPING * v if engaged else 0.0
            state = (x, v, push(t) + rng.normal(0.0, noise))
            for step in range(STEPS):
                drag = STIFFNESS * x + DAMPING * v if engaged else FREE_DAMPING * v
                v += (push(t + (step + 0.5) * 1e-3 / STEPS) - drag) / MASS * 1e-3 / STEPS
                x += v * 1e-3 / STEPS
            if cycle in lost:
                missed += 1
                continue
            lateness = late(cycle) if late else 0
            values = (
                (cycle, time_ns, state[0], 0.0, 0.0, state[1], 0.0, 0.0, state[2], 0.0, 0.0),
                (cycle, time_ns, *[0.0] * 6, spring, 0.0, 0.0, float(engaged), 0.0, 0.0, *[0.0] * 5),
                (cycle, time_ns, lateness, 200_000, 100_000, lateness + 200_000, missed, 1e-3, 0),
            )
            channels = (DEVICE_STATE_CHANNEL, DEVICE_COMMAND_CHANNEL, LOOP_TIMING_CHANNEL)
            for channel, message, row in zip(
                channels, (DEVICE_STATE, DEVICE_COMMAND, LOOP_TIMING), values, strict=True
            ):
                writer.add(channel.id, time_ns, message.pack(*row))
            writer.end_full_chunk()
    return path
