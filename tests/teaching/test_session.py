"""The session on its own: fed with made-up states of the loop, tick by tick."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from session_bench import ASSIST_STIFFNESS, DEPTH, DT, N_ACC, Teacher, plane_learner

from hm_driver.errors import ConfigurationError
from teaching.arbitration import ConfidenceArbitration, ErrorArbitration, ExistenceArbitration, Query
from teaching.correction import Region
from teaching.lwr import LWR
from teaching.session import INTENTION_S, Coupling, ForceFeedback, SessionOptions, Stage
from teaching.task import Contact, Task

# Stages


def test_the_stages_come_in_order_and_each_is_told_once(paper):
    teacher = Teacher(paper, practice=0.5, give_up=1.0, autonomous_spacing=0.2)
    teacher.teach(1.6)
    teacher.run_alone()
    stages = [tick.stage for tick in teacher.ticks]
    assert stages == sorted(stages)
    assert teacher.events("stage") == ["practice", "teaching", "autonomous", "done"]


def test_practice_lasts_as_long_as_asked_and_accumulates_nothing(paper):
    teacher = Teacher(paper, practice=1.0)
    ticks = teacher.teach(1.0)
    assert {tick.C for tick in ticks} == {1.0}
    assert not any(tick.recorded or tick.accumulated for tick in ticks[:-1])
    assert [tick.stage for tick in ticks[:99]] == [Stage.PRACTICE] * 99
    assert teacher.teach(0.02)[-1].recorded


def test_in_practice_the_human_keeps_control_even_where_there_are_models(paper):
    teacher = Teacher(paper, practice=0.5, learner=plane_learner())
    assert {tick.C for tick in teacher.teach(0.4)} == {1.0}


def test_autonomy_begins_once_the_plane_is_covered_and_examined(paper):
    teacher = Teacher(paper, learner=plane_learner(hole=(0.05, 0.05)), examination=1.0)
    assert teacher.teach_until_update().update.coverage == 1.0
    ticks = teacher.teach(1.2)
    begun = next(i for i, tick in enumerate(ticks) if tick.stage is Stage.AUTONOMOUS)
    assert begun * DT == pytest.approx(1.0, abs=2.0 * DT)


def test_autonomy_waits_for_coverage(paper):
    teacher = Teacher(paper, examination=0.0)
    tick = teacher.teach_until_update()
    assert 0.0 < tick.update.coverage < 0.99
    assert teacher.teach(2.0)[-1].stage is Stage.TEACHING


def test_a_threshold_above_one_never_lets_the_skill_go_on_by_itself(paper):
    learner = plane_learner(hole=(0.05, 0.05))
    teacher = Teacher(paper, learner=learner, examination=0.0, autonomy_coverage=1.01)
    assert teacher.teach_until_update().update.coverage == 1.0
    assert teacher.teach(1.0)[-1].stage is Stage.TEACHING


@pytest.mark.parametrize("practice", [0.0, 10.0])
def test_the_user_can_let_the_skill_go_on_alone_at_any_time(paper, practice):
    teacher = Teacher(paper, practice=practice)
    teacher.teach(0.2)
    teacher.session.request_autonomy()
    assert teacher.tick().stage is Stage.AUTONOMOUS


def test_teaching_that_does_not_cover_the_plane_ends_in_time(paper):
    teacher = Teacher(paper, practice=0.5, give_up=1.0)
    stages = [tick.stage for tick in teacher.teach(2.0)]
    assert stages.count(Stage.TEACHING) * DT == pytest.approx(1.0, abs=2.0 * DT)
    assert stages[-1] is Stage.AUTONOMOUS


# Accumulation and learning


def test_only_samples_of_which_the_human_alone_was_in_control_are_accumulated(paper):
    teacher = Teacher(paper)
    teacher.teach_until_update()
    before = teacher.ticks[-1].accumulated
    ticks = teacher.teach(1.0)
    assert {tick.recorded for tick in ticks if tick.C < 1.0} == {False}
    assert ticks[-1].accumulated == before + sum(tick.recorded for tick in ticks)
    away = [teacher.tick(x=-0.15, y=-0.15) for _ in range(60)]
    assert [tick.recorded for tick in away] == [tick.C == 1.0 for tick in away]
    assert away[-1].recorded


@pytest.mark.parametrize("place", [{"x": 0.21, "y": 0.0}, {"x": 0.0, "y": -0.21}])
def test_nothing_is_accumulated_beside_the_plane(paper, place):
    assert not Teacher(paper).tick(**place).recorded


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_nothing_is_accumulated_while_the_handle_is_on_its_way_to_another_depth(paper, direction):
    teacher = Teacher(paper, transient_speed=0.05)
    assert not teacher.tick(velocity_z=0.051 * direction).recorded
    assert teacher.tick(velocity_z=0.049 * direction).recorded


def test_samples_without_contact_are_accumulated_only_where_asked_and_then_as_no_depth(paper):
    assert not Teacher(paper, record_without_contact=False).tick(depth=-0.01).recorded
    assert Teacher(paper, record_without_contact=False).tick(depth=0.01).recorded
    teacher = Teacher(paper, record_without_contact=True)
    update = teacher.teach_until_update(depth=-0.01).update
    assert update.learner.query(0.05, 0.05)[0] == pytest.approx(0.0, abs=1e-12)


def test_an_update_is_learned_aside_a_few_samples_a_tick_and_swapped_in_whole(paper):
    teacher = Teacher(paper, samples_per_tick=30)
    ticks = teacher.teach((N_ACC - 1) * DT)
    assert not any(tick.is_learning for tick in ticks)
    old = teacher.session.learner
    during = [teacher.tick() for _ in range(4)]
    assert [tick.is_learning for tick in during] == [True, True, True, False]
    assert [tick.update is None for tick in during] == [True, True, True, False]
    assert old.n_samples == 0
    assert {tick.w_max for tick in during} == {0.0}
    update = during[-1].update
    assert update.number == teacher.session.updates == 1
    assert update.learner is teacher.session.learner
    assert update.learner.n_samples == N_ACC
    assert teacher.tick().w_max > 0.5


def test_what_was_swapped_in_is_not_changed_by_the_next_update(paper):
    teacher = Teacher(paper)
    first = teacher.teach_until_update().update
    before = first.learner.models.M.tobytes()
    second = teacher.teach_until_update(x=-0.1, y=-0.1).update
    assert second.number == 2
    assert second.learner.n_samples == 2 * N_ACC
    assert first.learner.n_samples == N_ACC
    assert first.learner.models.M.tobytes() == before


def test_each_tick_learns_no_more_samples_than_allowed(paper):
    class Counting(LWR):
        batches = []  # noqa: RUF012  # shared with the copy that learns

        def partial_fit(self, X, Y):
            self.batches.append(len(X))
            return super().partial_fit(X, Y)

    Teacher(paper, learner=Counting(), samples_per_tick=7).teach(1.5)
    assert max(Counting.batches) == 7
    assert sum(Counting.batches) == N_ACC


def test_batches_that_are_complete_while_one_is_learned_wait_for_their_turn(paper):
    teacher = Teacher(paper, n_acc=10, samples_per_tick=1)
    places = [(0.05 * i - 0.15, 0.05 * j - 0.15) for i in range(4) for j in range(4)]
    for k in range(40):
        x, y = places[k % len(places)]
        teacher.tick(x=x, y=y)
    teacher.teach(1.0, x=0.19, y=-0.19)
    updates = [tick.update for tick in teacher.ticks if tick.update]
    assert [update.number for update in updates] == list(range(1, len(updates) + 1))
    assert [update.learner.n_samples for update in updates] == [10 * u.number for u in updates]


# Control


@given(st.lists(st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)), min_size=2, max_size=15))
@settings(max_examples=30, deadline=None)
def test_the_control_factor_follows_eq_9_no_faster_than_a_hand_over_takes(paper, places):
    learner = LWR(D=400.0)
    learner.partial_fit(np.zeros((5, 2)), np.full((5, 1), DEPTH))
    arbitration = ExistenceArbitration(0.5, 0.05)
    teacher = Teacher(paper, learner=learner, hand_over=0.2, n_acc=100_000)
    C = 1.0
    for x, y in places:
        for tick in teacher.teach(0.1, x=x, y=y):
            wanted = arbitration.factor(Query(tick.y_robot, tick.w_max))
            assert 0.0 <= tick.C <= 1.0
            assert abs(tick.C - C) <= DT / 0.2 + 1e-12
            assert abs(tick.C - wanted) <= max(0.0, abs(C - wanted) - DT / 0.2) + 1e-12
            C = tick.C


def test_without_a_least_duration_the_control_factor_is_eq_9(paper):
    teacher = Teacher(paper, learner=plane_learner(), hand_over=0.0)
    assert teacher.tick().C == 0.0


def test_a_hand_over_is_told_and_counted(paper):
    learner = LWR(D=400.0)
    learner.partial_fit(np.zeros((5, 2)), np.full((5, 1), DEPTH))
    teacher = Teacher(paper, learner=learner, n_acc=100_000)
    teacher.teach(1.0, x=0.0, y=0.0)
    teacher.teach(1.0, x=0.15, y=0.0)
    assert teacher.events("hand-over") == ["the skill is in control", "the human is in control"]
    assert teacher.session.hand_overs == 2


@given(st.floats(-0.02, 0.15), st.floats(-20.0, 20.0))
@settings(max_examples=40, deadline=None)
def test_what_the_demonstrator_commands_is_the_handle_and_in_the_blend_his_estimated_intention(
    paper, depth, force_z
):
    teacher = Teacher(paper, learner=plane_learner(), hand_over=0.5, practice=2.0)
    for alone in teacher.teach(1.9, depth=depth, force_z=force_z):
        assert alone.C == 1.0
        assert alone.y_demo == pytest.approx(max(0.0, depth), abs=1e-12)
    for blended in teacher.teach(0.5, depth=depth, force_z=force_z)[15:]:
        assert 0.0 < blended.C < 1.0
        # a hand that pushes down, F < 0, wants to be deeper than the handle is
        intended = depth - force_z * paper.scale[2] / ASSIST_STIFFNESS
        assert blended.y_demo == pytest.approx(max(0.0, intended), abs=1e-9)


def test_a_jerk_of_the_hand_enters_the_estimate_of_his_intention_smoothly(paper):
    teacher = Teacher(paper, learner=plane_learner(), hand_over=10.0)
    teacher.teach(1.0, depth=0.02)
    push = [tick.y_demo - 0.02 for tick in teacher.teach(0.5, depth=0.02, force_z=-3.0)]
    whole = 3.0 / ASSIST_STIFFNESS
    assert push[round(INTENTION_S / DT)] == pytest.approx((1.0 - math.exp(-1.0)) * whole, rel=0.15)
    assert push[-1] == pytest.approx(whole, rel=1e-3)
    assert all(b > a for a, b in itertools.pairwise(push))


def test_the_command_is_the_blend_of_eq_8(paper):
    teacher = Teacher(paper, learner=plane_learner(0.08), hand_over=0.5)
    for tick in teacher.teach(1.0, depth=0.03, force_z=-2.0):
        assert tick.y_cmd == pytest.approx(tick.C * tick.y_demo + (1.0 - tick.C) * tick.y_robot)
    assert tick.C == 0.0
    assert tick.y_cmd == tick.y_robot == pytest.approx(0.08, abs=1e-3)


def test_the_skill_never_commands_above_the_surface_or_deeper_than_the_limit(paper):
    for depth, commanded in ((-0.05, 0.0), (0.5, SessionOptions().depth_limit)):
        tick = Teacher(paper, learner=plane_learner(depth), hand_over=0.0).tick()
        assert tick.y_robot == tick.y_cmd == commanded


# Set-points


def test_in_control_the_human_is_assisted_and_out_of_it_only_the_spring_in_z_is_engaged(paper):
    teacher = Teacher(paper, learner=plane_learner(), practice=0.05)
    for tick in teacher.teach(1.0):
        u = tick.set_point
        alone = float(tick.C == 1.0)
        assert (u.assist, u.engage_z) == (alone, 1.0 - alone)
        assert (u.engage_x, u.engage_y) == (0.0, 0.0)


def test_the_target_in_z_is_the_command_and_carries_its_velocity(paper):
    teacher = Teacher(paper, learner=plane_learner(0.08), hand_over=0.5)
    ticks = teacher.teach(0.4, depth=0.03)
    for before, tick in itertools.pairwise(ticks):
        u = tick.set_point
        assert u.target_z == pytest.approx(paper.handle_z(tick.y_cmd))
        assert u.velocity_z == pytest.approx((u.target_z - before.set_point.target_z) / DT)
    assert ticks[0].set_point.velocity_z == 0.0


def test_every_tick_has_a_set_point_of_its_own(paper):
    ticks = Teacher(paper).teach(0.5)
    assert [tick.set_point.sequence for tick in ticks] == list(range(1, 51))


def test_force_is_rendered_on_the_hand_only_where_asked_and_never_in_the_autonomous_run(paper):
    seen = Teacher(paper).tick()
    assert seen.force > 0.0
    assert seen.set_point.bias_z == 0.0
    teacher = Teacher(paper, force_feedback=ForceFeedback.RENDERED, feedback_gain=0.3)
    felt = teacher.tick()
    assert felt.set_point.bias_z == pytest.approx(0.3 * felt.force)
    assert felt.set_point.bias_x == felt.set_point.bias_y == 0.0
    teacher.session.request_autonomy()
    assert teacher.tick().set_point.bias_z == 0.0


# Autonomous run


def test_the_autonomous_run_passes_the_whole_plane_and_stays_on_it(paper):
    teacher = Teacher(paper, learner=plane_learner(), autonomous_spacing=0.05)
    teacher.tick(x=0.0, y=0.0)
    teacher.session.request_autonomy()
    teacher.run_alone()
    path = np.array(
        [
            paper.to_manipulator(u.target_x, u.target_y, u.target_z)[:2]
            for u in (tick.set_point for tick in teacher.ticks if tick.stage is Stage.AUTONOMOUS)
        ]
    )
    assert np.abs(path).max() <= 0.5 * paper.size
    for corner in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        assert np.hypot(*(path - 0.2 * np.array(corner)).T).min() < 0.04
    lines = np.unique(np.round(path[np.abs(path[:, 0]) < 0.01, 1], 3))
    assert np.diff(lines).max() <= 0.05 + 1e-3


def test_the_autonomous_run_engages_every_axis_and_carries_velocity(paper):
    teacher = Teacher(paper, learner=plane_learner(), autonomous_spacing=0.1)
    teacher.session.request_autonomy()
    teacher.tick(x=0.0, y=0.0)
    teacher.run_alone()
    points = [tick.set_point for tick in teacher.ticks if tick.stage is Stage.AUTONOMOUS]
    assert {(u.engage_x, u.engage_y, u.engage_z, u.assist) for u in points} == {(1.0, 1.0, 1.0, 0.0)}
    for before, u in itertools.pairwise(points):
        assert u.velocity_x == pytest.approx((u.target_x - before.target_x) / DT, abs=1e-9)
        assert u.velocity_y == pytest.approx((u.target_y - before.target_y) / DT, abs=1e-9)
    speeds = [math.hypot(u.velocity_x * paper.scale[0], u.velocity_y * paper.scale[1]) for u in points]
    assert max(speeds) == pytest.approx(0.15)
    assert max(abs(b - a) for a, b in itertools.pairwise(speeds)) < 0.05


def test_when_it_is_done_every_spring_is_let_go(paper):
    teacher = Teacher(paper, learner=plane_learner(), autonomous_spacing=0.4)
    teacher.session.request_autonomy()
    teacher.tick()
    teacher.run_alone()
    u = teacher.ticks[-1].set_point
    assert (u.assist, u.engage_x, u.engage_y, u.engage_z) == (0.0, 0.0, 0.0, 0.0)


def test_the_demonstrator_is_asked_to_let_go_when_the_autonomous_run_begins(paper):
    teacher = Teacher(paper)
    assert not teacher.tick().seen.autonomous
    teacher.session.request_autonomy()
    assert teacher.tick().seen.autonomous


# What the session may know


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Unknown(Task):
    """The paper's plane, but nobody may know how stiff it is, and what force it takes."""

    def stiffness(self, *_):
        return math.nan

    def contact(self, *place):
        return Contact(self.surface_z, max(0.0, self.surface_z - place[2]), math.nan, math.nan)

    def press(self, x, y, _):
        return self.object_at(x, y), math.nan, math.nan

    def required_depth(self, *_):
        pytest.fail("the session asked for the true depth")


def blind(task):
    fields = {f.name: getattr(task, f.name) for f in dataclasses.fields(task) if f.init}
    unknown = Unknown(**fields)
    object.__setattr__(unknown, "reference_force", math.nan)
    return unknown


def test_no_set_point_depends_on_the_true_stiffness_the_true_depth_or_the_reference_force(paper):
    paths = []
    for task in (paper, blind(paper)):
        teacher = Teacher(task, hand_over=0.1, give_up=6.0, autonomous_spacing=0.2)
        for k in range(550):
            angle = 0.02 * k
            teacher.tick(
                0.15 * math.cos(angle), 0.15 * math.sin(angle), 0.04 + 0.02 * math.sin(angle), force_z=3.0
            )
        teacher.teach(1.0)
        teacher.run_alone()
        paths.append([tick.set_point for tick in teacher.ticks])
    assert paths[0] == paths[1]
    assert {0.0, 1.0} == {u.engage_z for u in paths[0]} == {u.assist for u in paths[0]}


def test_what_the_demonstrator_sees_holds_no_stiffness(paper):
    seen = Teacher(paper).tick().seen
    assert not [name for name in seen._fields if "stiff" in name]
    assert seen.depth == pytest.approx(DEPTH)
    assert seen.surface == paper.object_at(0.05, 0.05)


# Options


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("practice", -1.0),
        ("practice", math.nan),
        ("autonomy_coverage", 0.0),
        ("examination", -0.1),
        ("give_up", 0.0),
        ("hand_over", -0.1),
        ("transient_speed", 0.0),
        ("hand_over", math.inf),
        ("samples_per_tick", 0),
        ("autonomous_speed", 0.0),
        ("autonomous_acceleration", math.nan),
        ("autonomous_spacing", 1e-9),
        ("feedback_gain", -0.5),
        ("settling", -0.1),
        ("stay", math.nan),
        ("hindsight", 11.0),
        ("flush", -1),
        ("transient_rate", -1.0),
    ],
)
def test_a_value_out_of_range_names_its_field(name, value):
    with pytest.raises(ConfigurationError) as caught:
        SessionOptions(**{name: value})
    assert caught.value.field == name


# What counts as a demonstration


def moved(teacher, seconds, **where):
    """Ticks on the way to another depth."""
    return teacher.teach(seconds, velocity_z=0.1, **where)


def test_with_hindsight_what_he_held_just_before_a_transient_is_dropped(paper):
    teacher = Teacher(paper, n_acc=1000, hindsight=20)
    teacher.teach(0.5)
    assert teacher.ticks[-1].accumulated == 30
    moved(teacher, 0.1)
    assert teacher.ticks[-1].accumulated == 30
    assert teacher.teach(0.25)[-1].accumulated == 35


def test_what_waits_is_learned_once_nothing_speaks_against_it(paper):
    learner = LWR(D=400.0)
    learner.partial_fit(np.zeros((5, 2)), np.full((5, 1), DEPTH))
    teacher = Teacher(paper, n_acc=1000, hindsight=20, learner=learner, flush=1)
    teacher.teach(0.5, x=0.15, y=0.0)
    teacher.teach(0.5, x=0.0, y=0.0)
    update = next(tick.update for tick in teacher.ticks if tick.update)
    assert update.learner.n_samples == 5 + sum(tick.recorded for tick in teacher.ticks)


def test_after_a_take_over_no_sample_is_taken_for_a_while(paper):
    learner = LWR(D=400.0)
    learner.partial_fit(np.zeros((5, 2)), np.full((5, 1), DEPTH))
    teacher = Teacher(paper, n_acc=1000, learner=learner, settling=0.2)
    assert teacher.tick(x=0.15, y=0.0).recorded
    teacher.teach(0.5, x=0.0, y=0.0)
    ticks = teacher.teach(1.0, x=0.15, y=0.0)
    alone = next(i for i, tick in enumerate(ticks) if tick.C == 1.0)
    first = next(i for i, tick in enumerate(ticks) if tick.recorded)
    assert (first - alone) * DT == pytest.approx(0.2, abs=1.5 * DT)


@pytest.mark.parametrize(("flush", "updates"), [(0, 0), (30, 1), (60, 0)])
def test_a_hand_over_to_the_skill_learns_what_there_is_if_it_is_enough(paper, flush, updates):
    learner = LWR(D=400.0)
    learner.partial_fit(np.zeros((5, 2)), np.full((5, 1), DEPTH))
    teacher = Teacher(paper, n_acc=1000, learner=learner, flush=flush)
    teacher.teach(0.5, x=0.15, y=0.0)
    ticks = teacher.teach(0.5, x=0.0, y=0.0)
    assert teacher.session.updates == updates
    assert ticks[-1].accumulated == (0 if updates else 50)


def test_control_can_be_made_to_stay_with_the_human(paper):
    learner = LWR(D=400.0)
    learner.partial_fit(np.zeros((5, 2)), np.full((5, 1), DEPTH))
    for stay, hand_overs in ((0.0, 7), (5.0, 2)):
        teacher = Teacher(paper, n_acc=10_000, learner=learner.copy(), stay=stay, hand_over=0.1)
        for k in range(8):
            teacher.teach(0.5, x=0.0 if k % 2 == 0 else 0.15, y=0.0)
        assert teacher.session.hand_overs == pytest.approx(hand_overs, abs=1)


# A stalled machine


@given(st.floats(0.03, 3.0), st.integers(0, 400))
@settings(max_examples=20, deadline=None)
def test_after_a_stall_the_set_point_goes_on_by_no_more_than_two_ticks(paper, stall, when):
    teacher = Teacher(paper, learner=plane_learner(), autonomous_spacing=0.1)
    teacher.session.request_autonomy()
    teacher.teach(0.5)
    for _ in range(when):
        follow(teacher)
    before = teacher.ticks[-1].set_point
    after = follow(teacher, dt=stall).set_point
    way = math.hypot(after.target_x - before.target_x, after.target_y - before.target_y)
    assert way <= 0.15 / min(paper.scale[:2]) * 2.0 * DT + 1e-9
    assert math.hypot(after.velocity_x, after.velocity_y) <= 0.15 / min(paper.scale[:2]) + 1e-9


def follow(teacher, **more):
    u = teacher.ticks[-1].set_point
    x, y, z = teacher.task.to_manipulator(u.target_x, u.target_y, u.target_z)
    return teacher.tick(x, y, teacher.task.surface_z - z, **more)


def test_a_stall_counts_as_time_but_does_not_hasten_a_hand_over(paper):
    teacher = Teacher(paper, learner=plane_learner(), practice=1.0, hand_over=0.3)
    teacher.teach(0.5)
    tick = teacher.tick(dt=5.0)
    assert tick.stage is Stage.TEACHING
    assert tick.C == pytest.approx(1.0 - 0.02 / 0.3)
    teacher = Teacher(paper, give_up=3.0)
    teacher.teach(0.5)
    assert teacher.tick(dt=5.0).stage is Stage.AUTONOMOUS


# The uncoupled variant


def test_uncoupled_the_handle_stays_free_and_the_blend_moves_the_manipulator(paper):
    teacher = Teacher(paper, learner=plane_learner(0.08), coupling=Coupling.UNCOUPLED, n_acc=10_000)
    for tick in teacher.teach(1.0, depth=0.03, force_z=-5.0):
        assert (tick.set_point.assist, tick.set_point.engage_z) == (1.0, 0.0)
        assert tick.y_demo == tick.y_handle == pytest.approx(0.03)
        assert tick.depth == tick.y_cmd == pytest.approx(tick.C * 0.03 + (1.0 - tick.C) * tick.y_robot)
        assert tick.force == pytest.approx(tick.stiffness * tick.y_cmd)
        assert tick.seen.is_free
        assert tick.seen.force == tick.force
    assert tick.C == 0.0
    assert tick.force == pytest.approx(0.08 * tick.stiffness, rel=1e-3)


def test_uncoupled_the_autonomous_run_moves_handle_and_manipulator(paper):
    teacher = Teacher(paper, learner=plane_learner(0.08), coupling=Coupling.UNCOUPLED)
    teacher.session.request_autonomy()
    teacher.teach(0.5)
    tick = teacher.ticks[-1]
    assert tick.set_point.engage_z == tick.set_point.engage_x == 1.0
    assert tick.set_point.assist == 0.0
    assert tick.depth == tick.y_cmd == pytest.approx(0.08, rel=1e-3)


# Gradual arbitrations


@pytest.mark.parametrize("coupling", Coupling)
def test_with_a_gradual_arbitration_samples_are_taken_while_both_act(paper, coupling):
    arbitration = ErrorArbitration(alone=1.0, done=0.2, memory=5.0)
    teacher = Teacher(
        paper, learner=plane_learner(0.08), coupling=coupling, arbitration=arbitration, n_acc=10_000
    )
    ticks = teacher.teach(2.0, depth=0.05)
    assert {tick.C == 1.0 for tick in ticks} == {True, False}
    between = [tick for tick in ticks if 0.0 < tick.C < 1.0]
    assert len(between) > 100
    assert all(tick.recorded for tick in between)


def test_nothing_is_taken_once_the_skill_alone_acts(paper):
    teacher = Teacher(
        paper, learner=plane_learner(), coupling=Coupling.UNCOUPLED, arbitration=ErrorArbitration()
    )
    assert teacher.teach(2.0)[-1].C == 0.0
    assert not teacher.tick().recorded


def test_an_arbitration_with_a_state_learns_from_the_ticks_of_teaching_alone(paper):
    seen = []

    class Listening(ErrorArbitration):
        def observe(self, observation):
            seen.append(observation)

    teacher = Teacher(paper, practice=0.5, arbitration=Listening())
    teacher.teach(0.6)
    teacher.session.request_autonomy()
    teacher.teach(0.2)
    ticks = [tick for tick in teacher.ticks if tick.stage is Stage.TEACHING]
    assert [(o.x, o.C, o.y_demo, o.force) for o in seen] == [
        (tick.x, tick.C, tick.y_demo, tick.force) for tick in ticks
    ]


# Doubt


def test_with_doubt_autonomy_waits_until_the_skill_is_sure_of_itself(paper):
    rng = np.random.default_rng(5)
    learner = plane_learner()
    learner.partial_fit(rng.uniform(-0.2, 0.2, (1500, 2)), rng.uniform(0.01, 0.15, (1500, 1)))
    for arbitration, autonomous in ((ExistenceArbitration(), True), (ConfidenceArbitration(), False)):
        teacher = Teacher(paper, learner=learner.copy(), arbitration=arbitration, examination=0.1, flush=1)
        teacher.teach(0.3)
        teacher.session.forget(Region(0.05, 0.05, 0.02))
        teacher.teach(3.0)
        assert teacher.session.updates > 0
        assert (teacher.ticks[-1].stage is Stage.AUTONOMOUS) == autonomous
    assert 0.0 < teacher.ticks[-1].std < math.inf


def test_the_doubt_of_the_whole_plane_is_asked_for_over_many_ticks(paper):
    class Asked(LWR):
        queries = [0]  # noqa: RUF012  # shared with the copy that learns

        def query_std(self, *place):
            self.queries[0] += 1
            return super().query_std(*place)

    teacher = Teacher(paper, learner=Asked(), arbitration=ConfidenceArbitration())
    most = 0
    for _ in range(300):
        before = Asked.queries[0]
        teacher.tick()
        most = max(most, Asked.queries[0] - before)
    assert teacher.session.updates > 0
    assert most <= 100
