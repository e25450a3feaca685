"""What the driver logs: its messages and channels. Standard library only, the loop process imports it.

There is no registry to register with: whoever records hands the recorder the channels that he writes. The
driver's own have the ids 1 to 15, its bundles 16 to 31; those of other packages begin at 32.
"""

import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from hm_driver.recording.messages import Field, FixedMessage, Kind, Message, VariableMessage

__all__ = [
    "DEVICE_CHANNELS",
    "DEVICE_COMMAND",
    "DEVICE_COMMAND_CHANNEL",
    "DEVICE_STATE",
    "DEVICE_STATE_CHANNEL",
    "EVENT",
    "EVENTS_CHANNEL",
    "EVENT_LEVELS",
    "FIRST_FREE_CHANNEL",
    "LOOP_BUNDLE",
    "LOOP_TIMING",
    "LOOP_TIMING_CHANNEL",
    "Bundle",
    "Channel",
    "Field",
    "FixedMessage",
    "Kind",
    "Message",
    "VariableMessage",
]

_SEQUENCE = Field("sequence", Kind.FIXED64, "Number of the cycle, counted on the loop's grid")
_TIME = Field("time_ns", Kind.SFIXED64, "Time of the session's clock, since the Unix epoch", "ns")

DEVICE_STATE = FixedMessage(
    "DeviceState",
    "What the device measured in a cycle, in its own frame: x towards the user, y to the right, z up.",
    (
        _SEQUENCE,
        _TIME,
        Field("measured_position", Kind.VECTOR3, "Position of the end effector", "m"),
        Field("model_velocity", Kind.VECTOR3, "Velocity of the device's virtual mass", "m/s"),
        Field("measured_force", Kind.VECTOR3, "Force of the hand on the end effector", "N"),
    ),
)

DEVICE_COMMAND = FixedMessage(
    "DeviceCommand",
    "What the loop commanded in a cycle, behind every limit.",
    (
        _SEQUENCE,
        _TIME,
        Field("reference", Kind.VECTOR3, "Reference of the position springs", "m"),
        Field("reference_velocity", Kind.VECTOR3, "Velocity of the reference", "m/s"),
        Field("spring_force", Kind.VECTOR3, "Commanded force of the position springs", "N"),
        Field("phase", Kind.VECTOR3, "Each position spring: 0 admittance, 1 position, 2 releasing"),
        Field("assist_reference", Kind.DOUBLE, "Rest height of the spring that assists the hand", "m"),
        Field("assist_force", Kind.DOUBLE, "Commanded force of that spring, along z", "N"),
        Field("bias_force", Kind.VECTOR3, "Bias force on the end effector", "N"),
    ),
)

LOOP_TIMING = FixedMessage(
    "LoopTiming",
    "How punctual a cycle of the loop was.",
    (
        _SEQUENCE,
        _TIME,
        Field("lateness_ns", Kind.SFIXED64, "Wake-up behind the cycle's point on the grid", "ns"),
        Field("execution_ns", Kind.SFIXED64, "Time of the whole cycle", "ns"),
        Field("exchange_ns", Kind.SFIXED64, "Time of the exchange with the device", "ns"),
        Field("response_ns", Kind.SFIXED64, "From the cycle's point on the grid to the command sent", "ns"),
        Field("missed_periods", Kind.FIXED64, "Periods skipped since the loop started"),
        Field("dt_s", Kind.DOUBLE, "Time step handed to the control law", "s"),
        Field(
            "saturated_cycles",
            Kind.FIXED64,
            "Cycles with a joint at its velocity limit since the loop started",
        ),
    ),
)

EVENT_LEVELS = {"debug": 1, "info": 2, "warning": 3, "error": 4}
"""Number of each level, as in ``foxglove.Log``."""

EVENT = VariableMessage(
    "Event",
    "Something that happened once.",
    (
        Field("sequence", Kind.FIXED64, "Number of the event"),
        _TIME,
        Field("level", Kind.FIXED32, "1 debug, 2 info, 3 warning, 4 error"),
        Field("name", Kind.TEXT, "Short name, to search for"),
        Field("text", Kind.TEXT, "What happened, in words"),
        Field("values", Kind.DOUBLES, "Numbers that belong to the event"),
    ),
)


@dataclass(frozen=True, slots=True)
class Channel:
    """One topic of a log.

    Args:
        id: Number of the channel in the ring and in the file, 1 to 65535.
        topic: Name of the topic.
        message: What it carries.
    """

    id: int
    topic: str
    message: Message


DEVICE_STATE_CHANNEL = Channel(1, "/device/state", DEVICE_STATE)
DEVICE_COMMAND_CHANNEL = Channel(2, "/device/command", DEVICE_COMMAND)
LOOP_TIMING_CHANNEL = Channel(3, "/loop/timing", LOOP_TIMING)
EVENTS_CHANNEL = Channel(4, "/events", EVENT)

DEVICE_CHANNELS = (DEVICE_STATE_CHANNEL, DEVICE_COMMAND_CHANNEL, LOOP_TIMING_CHANNEL, EVENTS_CHANNEL)
"""Everything that the driver itself logs."""

FIRST_FREE_CHANNEL = 32
"""Where the ids of other packages begin."""


class Bundle:
    """Fixed messages of several channels that are always written together: one struct call, one record.

    Args:
        id: Number of the bundle in the ring; no channel has the same.
        channels: The channels, in the order of the values.

    Raises:
        ValueError: if a channel's message has no fixed width.
    """

    def __init__(self, id: int, channels: Iterable[Channel]) -> None:  # noqa: A002 - as in Channel
        self.id = id
        self.channels = tuple(channels)
        tags: list[object] = []
        codes, slices, start = ["<"], [], 0
        for channel in self.channels:
            message = channel.message
            if not isinstance(message, FixedMessage):
                problem = f"channel {channel.topic} carries {message.full_name}, which has no fixed width"
                raise ValueError(problem)  # noqa: TRY004 - a wrong choice of channel, not a wrong type
            for tag, code in message.layout:
                tags += (tag, 0)
                codes.append(f"{len(tag)}s{code}")
            slices.append((channel.id, start, start + message.size))
            start += message.size
        self.slices = tuple(slices)
        """Channel id, start and end of each message in the packed bundle."""
        self.size = start
        self._template = tags
        self._struct = struct.Struct("".join(codes))

    def __reduce__(self) -> tuple[type["Bundle"], tuple[int, tuple[Channel, ...]]]:
        return Bundle, (self.id, self.channels)

    def pack(self, *values: float) -> bytes:
        """Wire form of the values: those of the first message, then of the second, and so on."""
        parts = self._template[:]
        parts[1::2] = values
        return self._struct.pack(*parts)

    def pack_into(self, buffer: bytearray | memoryview, offset: int, *values: float) -> None:
        """Write the wire form of the values into ``buffer[offset : offset + size]``."""
        parts = self._template[:]
        parts[1::2] = values
        self._struct.pack_into(buffer, offset, *parts)

    def packer(self) -> Callable[[bytearray | memoryview, int, Sequence[float]], None]:
        """What `pack_into` does, as a function for one thread that packs in every cycle."""
        parts, pack_into = self._template[:], self._struct.pack_into

        def pack(buffer: bytearray | memoryview, offset: int, values: Sequence[float]) -> None:
            parts[1::2] = values
            pack_into(buffer, offset, *parts)

        return pack


LOOP_BUNDLE = Bundle(16, (DEVICE_STATE_CHANNEL, DEVICE_COMMAND_CHANNEL, LOOP_TIMING_CHANNEL))
"""What the loop writes in every cycle: state, command, timing."""
