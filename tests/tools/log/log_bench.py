"""A small log of a loop and its ticks, which a test may spoil."""

import json

from hm_driver.recording.schemas import (
    DEVICE_CHANNELS,
    DEVICE_COMMAND,
    DEVICE_COMMAND_CHANNEL,
    DEVICE_STATE,
    DEVICE_STATE_CHANNEL,
    EVENT,
    EVENTS_CHANNEL,
    LOOP_TIMING,
    LOOP_TIMING_CHANNEL,
)
from hm_driver.recording.writer import Attachment, LogWriter
from teaching.messages import ARBITRATION, ARBITRATION_CHANNEL

CONFIG = {
    "geometry": {"r0": 0.45},
    "modes": {"position_force_max": 30.0, "assist_force_max": 10.0},
    "limits": {"velocity_trip": 1.5, "force_trip": 80.0, "bias_max": 10.0, "reference_speed": 0.3},
}
MS = 1_000_000


def write(path, cycles=300, *, change=None, level=2, lost=()):
    """A log of a loop and its ticks; `change(topic, cycle, values)` may spoil a message."""
    channels = (*DEVICE_CHANNELS, ARBITRATION_CHANNEL)
    config = Attachment(name="config.json", media_type="application/json", data=json.dumps(CONFIG).encode())
    with LogWriter(path, channels, attachments=[config], chunk_bytes=4096) as writer:
        for cycle in range(cycles):
            if cycle in lost:
                continue
            time_ns = cycle * MS
            state = [cycle, time_ns, 0.01, 0.02, 0.0, 0.1, 0.0, 0.0, 1.0, 2.0, 3.0]
            command = [
                cycle,
                time_ns,
                *[0.0] * 3,
                0.1,
                0.0,
                0.0,
                5.0,
                0.0,
                0.0,
                *[0.0] * 3,
                0.0,
                1.0,
                *[0.0] * 3,
            ]
            timing = [cycle, time_ns, 0, 0, 0, 0, 0, 1e-3, 0]
            skipped = 1 if cycle - 1 in lost else 0
            for channel, message, values in (
                (DEVICE_STATE_CHANNEL, DEVICE_STATE, state),
                (DEVICE_COMMAND_CHANNEL, DEVICE_COMMAND, command),
                (LOOP_TIMING_CHANNEL, LOOP_TIMING, timing),
            ):
                if change:
                    change(channel.topic, cycle, values)
                writer.chunk.add(channel.id, values[1], message.pack(*values), skipped)
            if cycle % 10 == 0:
                tick = [time_ns, min(2, cycle // 100), 0.5, 0.5, *[0] * (len(ARBITRATION.columns) - 4)]
                if change:
                    change(ARBITRATION_CHANNEL.topic, cycle, tick)
                writer.add(ARBITRATION_CHANNEL.id, time_ns, ARBITRATION.pack(*tick))
            writer.end_full_chunk()
        writer.add(EVENTS_CHANNEL.id, cycles * MS, EVENT.pack(0, 0, level, "trip", "force 90 N", []))
    return path


def at(topic, cycle, place, value):
    def change(at_topic, at_cycle, values):
        if (at_topic, at_cycle) == (topic, cycle):
            values[place] = value

    return change
