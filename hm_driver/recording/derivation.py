"""Messages that the recorder makes of others: what a viewer draws, made where it costs the loop nothing."""

import math
from collections.abc import Iterator
from typing import NamedTuple, Protocol

from hm_driver.geometry import ArmGeometry
from hm_driver.recording.decoding import Decoder
from hm_driver.recording.foreign import Draft, foxglove
from hm_driver.recording.schemas import DEVICE_STATE, DEVICE_STATE_CHANNEL, EVENT, EVENTS_CHANNEL, Channel

FRAME = "hapticmaster"
"""Frame of the device: origin at the workspace centre, x towards the user, y to the right, z up."""
END_EFFECTOR = "end_effector"
"""Frame of the handle."""

POSE = foxglove("PoseInFrame")
TRANSFORM = foxglove("FrameTransform")
LOG = foxglove("Log")
SCENE = foxglove("SceneUpdate")

POSE_CHANNEL = Channel(5, "/device/pose", POSE)
TRANSFORM_CHANNEL = Channel(6, "/tf", TRANSFORM)
LOG_CHANNEL = Channel(7, "/log", LOG)
ARM_CHANNEL = Channel(8, "/device/arm", SCENE)


class Derived(NamedTuple):
    """A message made of another one."""

    channel: int
    """Id of its channel."""
    log_time_ns: int
    """Time of it [ns]."""
    payload: bytes
    """Its wire form."""


class Deriver(Protocol):
    """Makes messages of others; picklable, as it crosses into the recorder's process.

    The same messages in the same order must always give the same: a session on a virtual clock is
    reproducible to the byte.
    """

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels of what is made."""
        ...

    @property
    def sources(self) -> tuple[int, ...]:
        """Ids of the channels of what it is made of."""
        ...

    def derive(self, channel: int, log_time_ns: int, payload: bytes) -> Iterator[Derived]:
        """What is to follow a message of one of the sources."""
        ...


def set_time(timestamp: Draft, time_ns: int) -> None:
    """Set a ``google.protobuf.Timestamp``."""
    timestamp.seconds, timestamp.nanos = divmod(time_ns, 1_000_000_000)


class ArmDeriver:
    """Pose, transform and picture of the arm at a viewer's rate, and the events as a viewer's log.

    Args:
        geometry: The arm.
        every: One of so many device states is shown; the picture of the arm at a fifth of that.
    """

    channels = (POSE_CHANNEL, TRANSFORM_CHANNEL, LOG_CHANNEL, ARM_CHANNEL)
    sources = (DEVICE_STATE_CHANNEL.id, EVENTS_CHANNEL.id)

    def __init__(self, geometry: ArmGeometry, *, every: int = 20) -> None:
        self._geometry = geometry
        self._every = every
        self._states = 0
        self._events: Decoder | None = None
        self._place = DEVICE_STATE.columns.index("measured_position.x")

    def derive(self, channel: int, log_time_ns: int, payload: bytes) -> Iterator[Derived]:
        """What a viewer shows of a device state or an event."""
        if channel == EVENTS_CHANNEL.id:
            yield self._log(log_time_ns, payload)
            return
        number = self._states
        self._states += 1
        if number % self._every:
            return
        place = self._place
        x, y, z = DEVICE_STATE.unpack(payload)[place : place + 3]
        if not math.isfinite(x + y + z):
            return
        yield self._pose(log_time_ns, x, y, z)
        yield self._transform(log_time_ns, x, y, z)
        if number % (5 * self._every) == 0:
            yield self._arm(log_time_ns, x, y, z)

    def _pose(self, time_ns: int, x: float, y: float, z: float) -> Derived:
        message = POSE.message_class(frame_id=FRAME)
        set_time(message.timestamp, time_ns)
        set_vector(message.pose.position, x, y, z)
        message.pose.orientation.w = 1.0
        return Derived(POSE_CHANNEL.id, time_ns, message.SerializeToString())

    def _transform(self, time_ns: int, x: float, y: float, z: float) -> Derived:
        message = TRANSFORM.message_class(parent_frame_id=FRAME, child_frame_id=END_EFFECTOR)
        set_time(message.timestamp, time_ns)
        set_vector(message.translation, x, y, z)
        message.rotation.w = 1.0
        return Derived(TRANSFORM_CHANNEL.id, time_ns, message.SerializeToString())

    def _arm(self, time_ns: int, x: float, y: float, z: float) -> Derived:
        """The column, the radial arm and the handle."""
        geometry = self._geometry
        message = SCENE.message_class()
        entity = message.entities.add(id="arm", frame_id=FRAME)
        set_time(entity.timestamp, time_ns)
        low, high = geometry.z_min - 0.1, geometry.z_max + 0.1
        column = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
        set_vector(column.pose.position, -geometry.r0, 0.0, 0.5 * (low + high))
        column.pose.orientation.w = 1.0
        set_vector(column.size, 0.08, 0.08, high - low)
        paint(column.color, 0.35, 0.38, 0.42)
        beam = entity.lines.add(thickness=0.03)
        set_vector(beam.points.add(), -geometry.r0, 0.0, z)
        set_vector(beam.points.add(), x, y, z)
        beam.pose.orientation.w = 1.0
        paint(beam.color, 0.55, 0.58, 0.62)
        handle = entity.spheres.add()
        set_vector(handle.pose.position, x, y, z)
        handle.pose.orientation.w = 1.0
        set_vector(handle.size, 0.03, 0.03, 0.03)
        paint(handle.color, 0.0, 0.45, 0.70)
        return Derived(ARM_CHANNEL.id, time_ns, message.SerializeToString())

    def _log(self, time_ns: int, payload: bytes) -> Derived:
        if self._events is None:
            self._events = Decoder(EVENT.full_name, EVENT.file_descriptor_set())
        event = self._events.decode([payload])
        message = LOG.message_class(
            level=int(event["level"][0]), name=str(event["name"][0]), message=str(event["text"][0])
        )
        set_time(message.timestamp, time_ns)
        return Derived(LOG_CHANNEL.id, time_ns, message.SerializeToString())


def set_vector(vector: Draft, x: float, y: float, z: float) -> None:
    """Set the three components of a message."""
    vector.x, vector.y, vector.z = x, y, z


def paint(colour: Draft, r: float, g: float, b: float, a: float = 1.0) -> None:
    """Set a ``foxglove.Color``, each part 0 to 1."""
    colour.r, colour.g, colour.b, colour.a = r, g, b, a
