"""What a viewer gets to draw, read back by the generated classes."""

import math

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from hm_driver.realtime.options import LoopOptions
from hm_driver.recording.derivation import ArmDeriver
from hm_driver.recording.schemas import DEVICE_STATE, DEVICE_STATE_CHANNEL
from teaching.learner import ModelSet
from teaching.messages import LEARNER_STATE_CHANNEL, pack_learner_state
from teaching.task_file import load_task
from tools.run.scene import SceneDeriver

TASK = load_task("paper")


class TwoModels:
    """A learner of two models, one of them turned by 30 degrees."""

    n_inputs, n_outputs, n_samples, n_added, n_pruned = 2, 1, 10, 2, 0

    def __init__(self):
        c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
        turn = np.array([[c, -s], [s, c]])
        turned = turn @ np.diag([400.0, 1600.0]) @ turn.T
        self.models = ModelSet(
            centres=np.array([[0.1, -0.1], [0.0, 0.05]]),
            D=np.array([np.eye(2) * 400.0, turned]),
            M=np.zeros((2, 3, 1)),
            P=np.zeros((2, 3, 3)),
            samples=np.array([5, 5]),
            born=np.array([0, 1]),
        )
        self.say = np.ones(2)
        self.variances = None


def states(count):
    deriver = ArmDeriver(LoopOptions(url="sim://").geometry, every=4)
    for number in range(count):
        values = [number, 10**18 + number * 10**6, 0.01 * number, 0.2, -0.1] + [0.0] * 6
        yield from deriver.derive(DEVICE_STATE_CHANNEL.id, values[1], DEVICE_STATE.pack(*values))


def test_the_pose_is_the_measured_position_at_a_viewer_s_rate():
    poses = [PoseInFrame.FromString(one.payload) for one in states(40) if one.channel == 5]
    assert [round(pose.pose.position.x, 9) for pose in poses] == [round(0.04 * n, 9) for n in range(10)]
    assert {(pose.frame_id, pose.pose.orientation.w) for pose in poses} == {("hapticmaster", 1.0)}
    assert poses[1].timestamp.seconds * 10**9 + poses[1].timestamp.nanos == 10**18 + 4 * 10**6
    moved = [FrameTransform.FromString(one.payload) for one in states(40) if one.channel == 6]
    assert [one.translation.x for one in moved] == [pose.pose.position.x for pose in poses]


def test_the_radial_arm_reaches_from_the_column_to_the_handle():
    (first, second) = [SceneUpdate.FromString(one.payload) for one in states(40) if one.channel == 8]
    (entity,) = second.entities
    assert (entity.id, first.entities[0].id) == ("arm", "arm")
    ends = [(p.x, p.y, p.z) for p in entity.lines[0].points]
    assert ends == [(-0.45, 0.0, -0.1), (pytest.approx(0.2), 0.2, -0.1)]


def test_a_position_that_is_no_number_is_not_drawn():
    deriver = ArmDeriver(LoopOptions(url="sim://").geometry, every=1)
    payload = DEVICE_STATE.pack(0, 0, math.nan, *[0.0] * 8)
    assert list(deriver.derive(DEVICE_STATE_CHANNEL.id, 0, payload)) == []


def test_a_receptive_field_is_an_ellipse_in_the_handle_s_lengths_with_its_turn():
    deriver = SceneDeriver(TASK, w_th=0.5)
    payload = pack_learner_state(7, 1, 0.5, TwoModels())
    (derived,) = deriver.derive(LEARNER_STATE_CHANNEL.id, 7, payload)
    (entity,) = SceneUpdate.FromString(derived.payload).entities
    ellipses = entity.cylinders[::2]
    radius = math.sqrt(2.0 * math.log(2.0))
    first, second = ([each.size.x, each.size.y] for each in ellipses)
    assert first == pytest.approx([2.0 * radius / 20.0 / 1.3] * 2)
    assert sorted(second) == pytest.approx([2.0 * radius / 40.0 / 1.3, 2.0 * radius / 20.0 / 1.3])
    assert ellipses[0].pose.position.x == pytest.approx(0.1 / 1.3 + 0.005)
    turn = 2.0 * math.atan2(ellipses[1].pose.orientation.z, ellipses[1].pose.orientation.w)
    long_axis = turn if second[0] > second[1] else turn + 0.5 * math.pi
    assert math.tan(long_axis) == pytest.approx(math.tan(math.radians(30)))


def test_the_plane_is_drawn_once_in_the_colours_of_its_stiffness():
    deriver = SceneDeriver(TASK, w_th=0.5)
    state = DEVICE_STATE.pack(*[0] * 11)
    (derived,) = [*deriver.derive(1, 5, state), *deriver.derive(1, 6, state)]
    (entity,) = SceneUpdate.FromString(derived.payload).entities
    mesh = entity.triangles[0]
    assert len(mesh.points) == len(mesh.colors) == 6 * 40 * 40
    assert len({round(colour.r, 6) for colour in mesh.colors}) == 4
    assert max(point.x for point in mesh.points) == pytest.approx(0.2 / 1.3 + 0.005)
    assert [text.text for text in entity.texts] == [
        f"{thing.name} {thing.stiffness:g} N/m" for thing in TASK.objects
    ]
