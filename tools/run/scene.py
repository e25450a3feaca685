"""The scene of a session for viewers: the plane with its stiffness, and the receptive fields as they grow."""

import math
from collections.abc import Iterator

import numpy as np

from hm_driver.recording.decoding import Decoder
from hm_driver.recording.derivation import FRAME, SCENE, Derived, paint, set_time, set_vector
from hm_driver.recording.foreign import Draft
from hm_driver.recording.schemas import DEVICE_STATE_CHANNEL, FIRST_FREE_CHANNEL, Channel
from teaching.learner import FloatArray
from teaching.messages import LEARNER_STATE, LEARNER_STATE_CHANNEL
from teaching.task import Task

SCENE_CHANNEL = Channel(FIRST_FREE_CHANNEL + 10, "/scene", SCENE)

_CELLS = 40
_SOFT = np.array((0.99, 0.91, 0.66))
_STIFF = np.array((0.27, 0.13, 0.42))
_CENTRE = (0.84, 0.15, 0.16)
_ELLIPSE = (0.0, 0.45, 0.70)


class SceneDeriver:
    """Draws the plane when the session begins, and the receptive fields after each update.

    Lengths are the handle's, in the frame of the device, where the arm is drawn too.

    Args:
        task: The plane, and how the handle maps onto it.
        w_th: Activation at which a receptive field's ellipse is drawn.
    """

    channels = (SCENE_CHANNEL,)
    sources = (DEVICE_STATE_CHANNEL.id, LEARNER_STATE_CHANNEL.id)

    def __init__(self, task: Task, *, w_th: float) -> None:
        self._task = task
        self._radius = math.sqrt(-2.0 * math.log(w_th)) if 0.0 < w_th < 1.0 else 1.0
        self._has_begun = False
        self._learner: Decoder | None = None

    def derive(self, channel: int, log_time_ns: int, payload: bytes) -> Iterator[Derived]:
        """The plane at the first state of the device, the receptive fields after an update."""
        if channel == LEARNER_STATE_CHANNEL.id:
            yield self._fields(log_time_ns, payload)
        elif not self._has_begun:
            self._has_begun = True
            yield self._plane(log_time_ns)

    def _plane(self, time_ns: int) -> Derived:
        task = self._task
        ticks = np.linspace(-0.5 * task.size, 0.5 * task.size, _CELLS + 1)
        nodes = [(x, y) for x in ticks.tolist() for y in ticks.tolist()]
        middles = 0.5 * (ticks[:-1] + ticks[1:])
        cells = np.array([[task.stiffness(x, y) for y in middles.tolist()] for x in middles.tolist()])
        least, span = cells.min(), max(float(np.ptp(cells)), 1e-9)
        scene = SCENE.message_class()
        entity = _entity(scene, "plane", time_ns)
        mesh = entity.triangles.add()
        mesh.pose.orientation.w = 1.0
        row = _CELLS + 1
        for i in range(_CELLS):
            for j in range(_CELLS):
                share = (cells[i, j] - least) / span
                colour = (_SOFT + share * (_STIFF - _SOFT)).tolist()
                a, b, c, d = i * row + j, (i + 1) * row + j, (i + 1) * row + j + 1, i * row + j + 1
                for node in (a, b, c, a, c, d):
                    set_vector(mesh.points.add(), *task.to_handle(*nodes[node], task.surface_z))
                    paint(mesh.colors.add(), *colour)
        for thing in task.objects:
            x, y = np.mean(thing.outline, axis=0).tolist()
            text = entity.texts.add(
                text=f"{thing.name} {thing.stiffness:g} N/m", font_size=0.015, billboard=True
            )
            set_vector(text.pose.position, *task.to_handle(x, y, task.surface_z + 0.01))
            text.pose.orientation.w = 1.0
            paint(text.color, 0.1, 0.1, 0.1)
        return Derived(SCENE_CHANNEL.id, time_ns, scene.SerializeToString())

    def _fields(self, time_ns: int, payload: bytes) -> Derived:
        if self._learner is None:
            self._learner = Decoder(LEARNER_STATE.full_name, LEARNER_STATE.file_descriptor_set())
        state = self._learner.decode([payload])
        d = int(state["n_inputs"][0])
        centres = np.asarray(state["centres"][0]).reshape(-1, d)
        metrics = np.asarray(state["D"][0]).reshape(-1, d, d)
        scene = SCENE.message_class()
        entity = _entity(scene, "receptive fields", time_ns)
        for centre, metric in zip(centres, metrics, strict=True):
            self._draw(entity, centre[:2].tolist(), metric[:2, :2])
        return Derived(SCENE_CHANNEL.id, time_ns, scene.SerializeToString())

    def _draw(self, entity: Draft, centre: list[float], metric: FloatArray) -> None:
        task = self._task
        scale = np.diag(task.scale[:2])
        values, axes = np.linalg.eigh(scale @ metric @ scale)
        radii = self._radius / np.sqrt(np.maximum(values, 1e-12))
        turn = 0.5 * math.atan2(float(axes[1, 0]), float(axes[0, 0]))
        place = task.to_handle(centre[0], centre[1], task.surface_z)
        for size, colour, alpha, height in ((radii, _ELLIPSE, 0.15, 0.001), (None, _CENTRE, 1.0, 0.004)):
            cylinder = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
            set_vector(cylinder.pose.position, *place)
            cylinder.pose.orientation.z, cylinder.pose.orientation.w = math.sin(turn), math.cos(turn)
            a, b = (0.003, 0.003) if size is None else (2.0 * size).tolist()
            set_vector(cylinder.size, a, b, height)
            paint(cylinder.color, *colour, alpha)


def _entity(scene: Draft, name: str, time_ns: int) -> Draft:
    entity = scene.entities.add(id=name, frame_id=FRAME)
    set_time(entity.timestamp, time_ns)
    return entity
