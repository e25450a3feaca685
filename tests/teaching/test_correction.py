"""How the human corrects the skill: forgetting, undoing, discarding, insisting, and that nothing jumps."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from session_bench import DT, N_ACC, Teacher, plane_learner

from hm_driver.errors import ConfigurationError
from teaching.arbitration import (
    ButtonArbitration,
    ConfidenceArbitration,
    ErrorArbitration,
    ExistenceArbitration,
    SuccessArbitration,
    force_success,
)
from teaching.correction import CorrectionOptions, Insistence, Region
from teaching.session import Cause, Coupling, Stage

HERE = {"x": 0.05, "y": 0.05}
AWAY = {"x": -0.12, "y": -0.12}


def taught(paper, **more):
    """A session whose skill is in control all over the plane."""
    teacher = Teacher(paper, learner=plane_learner(), **more)
    assert teacher.teach(1.0, **HERE)[-1].C == 0.0
    return teacher


# Forgetting


def test_forgetting_removes_the_models_here_and_gives_control_back(paper):
    teacher = taught(paper)
    before = teacher.session.learner
    teacher.session.forget()
    tick = teacher.tick(**HERE)
    assert tick.update.cause is Cause.FORGET
    assert tick.update.learner is teacher.session.learner is not before
    assert tick.w_max < ExistenceArbitration().w_free
    assert tick.update.coverage == teacher.session.coverage < 1.0
    assert teacher.session.updates == tick.update.number == 0
    assert teacher.teach(0.4, **HERE)[-1].C == 1.0
    (text,) = teacher.events("forget")
    assert f"{before.n_models - teacher.session.learner.n_models} models" in text
    assert teacher.teach(1.0, **AWAY)[-1].C == 0.0


def test_a_region_elsewhere_can_be_forgotten(paper):
    teacher = taught(paper)
    teacher.session.forget(Region(AWAY["x"], AWAY["y"], 0.03))
    assert teacher.tick(**HERE).C == 0.0
    assert teacher.teach(1.0, **AWAY)[-1].C == 1.0


def test_teaching_resumes_where_was_forgotten_and_ends_again_once_it_is_covered(paper):
    teacher = taught(paper, examination=1.0)
    teacher.session.forget()
    teacher.tick(**HERE)
    update = teacher.teach_until_update(depth=0.08, **HERE).update
    assert update.cause is Cause.UPDATE
    assert update.number == 1
    assert update.learner.query(0.05, 0.05)[0] > 0.065


def test_with_the_plane_no_longer_covered_autonomy_waits(paper):
    teacher = Teacher(paper, learner=plane_learner(hole=(0.05, 0.05)), examination=1.0)
    assert teacher.teach_until_update(**HERE).update.coverage == 1.0
    teacher.teach(0.5, **HERE)
    teacher.session.forget(Region(-0.1, -0.1, 0.05))
    assert teacher.teach(2.0, **HERE)[-1].stage is Stage.TEACHING


def test_samples_of_the_region_that_are_not_yet_learned_are_forgotten_too(paper):
    teacher = Teacher(paper)
    teacher.teach(0.3, **HERE)
    teacher.teach(0.2, **AWAY)
    teacher.session.forget(Region(HERE["x"], HERE["y"], 0.02))
    assert teacher.tick(**AWAY).accumulated == 21
    assert "0 models and 30 samples" in teacher.events("forget")[0]


def test_a_batch_that_is_being_learned_does_not_bring_back_what_was_forgotten(paper):
    teacher = Teacher(paper, samples_per_tick=5)
    teacher.teach(0.5, **HERE)
    while not teacher.tick(**AWAY).is_learning:
        pass
    teacher.tick(**AWAY)
    teacher.session.forget(Region(HERE["x"], HERE["y"], 0.05))
    for _ in range(N_ACC):
        tick = teacher.tick(**AWAY)
        if tick.update is not None:
            break
    assert tick.update.cause is Cause.UPDATE
    assert tick.update.learner.query(x0=0.05, x1=0.05)[1] < 0.1
    assert tick.update.learner.query(-0.12, -0.12)[1] > 0.9


def test_everything_can_be_forgotten(paper):
    teacher = taught(paper)
    teacher.session.forget_all()
    tick = teacher.tick(**AWAY)
    assert tick.update.learner.n_models == 0
    assert tick.update.coverage == 0.0
    assert teacher.teach(0.4, **AWAY)[-1].C == 1.0


@pytest.mark.parametrize(
    "arbitration",
    [ErrorArbitration(), SuccessArbitration(force_success(10.0, 1e6))],
    ids=["error", "success"],
)
def test_a_gradual_arbitration_forgets_as_well(paper, arbitration):
    teacher = Teacher(paper, learner=plane_learner(), arbitration=arbitration.copy())
    assert teacher.teach(5.0, **HERE)[-1].C == 0.0
    teacher.session.forget()
    teacher.tick(**HERE)
    assert max(tick.C for tick in teacher.teach(0.4, **HERE)) > 0.9


# Undoing


def test_undoing_goes_back_step_by_step_to_the_very_skill_before(paper):
    teacher = taught(paper)
    first = teacher.session.learner
    teacher.session.forget()
    teacher.tick(**HERE)
    second = teacher.session.learner
    teacher.session.forget(Region(-0.1, -0.1, 0.05))
    teacher.tick(**HERE)
    teacher.session.undo()
    tick = teacher.tick(**HERE)
    assert tick.update.cause is Cause.UNDO
    assert teacher.session.learner is second
    teacher.session.undo()
    teacher.tick(**HERE)
    assert teacher.session.learner is first
    teacher.session.undo()
    assert teacher.tick(**HERE).update is None
    assert teacher.events("undo")[-1] == "there is nothing to undo"


def test_an_update_can_be_undone_and_what_is_being_learned_is_learned_into_the_skill_before(paper):
    teacher = Teacher(paper, samples_per_tick=10)
    first = teacher.teach_until_update(depth=0.02, **HERE).update.learner
    for _ in range(3 * N_ACC):
        if teacher.tick(**AWAY).is_learning:
            break
    teacher.session.undo()
    assert teacher.tick(**AWAY).update.learner.n_models == 0
    second = next(t for t in (teacher.tick(**AWAY) for _ in range(50)) if t.update).update.learner
    assert first.query(0.05, 0.05)[1] > 0.9
    assert first.n_samples == second.n_samples == N_ACC
    assert second.query(-0.12, -0.12)[1] > 0.9
    assert "undid update 1" in teacher.events("undo")[0]


def test_no_more_steps_are_kept_than_asked_for(paper):
    teacher = taught(paper, correction={"undo_steps": 1})
    for x in (0.0, 0.1):
        teacher.session.forget(Region(x, 0.0, 0.01))
        teacher.tick(**AWAY)
        teacher.session.undo()
        teacher.session.undo()
        assert teacher.tick(**AWAY).update.cause is Cause.UNDO
        assert teacher.events("undo")[-1] == "there is nothing to undo"


def test_what_was_demonstrated_can_be_discarded_before_it_is_learned(paper):
    teacher = Teacher(paper)
    teacher.teach(0.5, **HERE)
    teacher.session.discard()
    assert teacher.tick(**HERE).accumulated == 1
    assert teacher.events("discard") == ["50 samples were thrown away"]


@pytest.mark.parametrize("wish", ["forget", "forget_all", "undo", "discard"])
def test_the_autonomous_run_is_left_alone(paper, wish):
    teacher = taught(paper)
    before = teacher.session.learner
    teacher.session.request_autonomy()
    getattr(teacher.session, wish)()
    tick = teacher.tick(**HERE)
    assert tick.stage is Stage.AUTONOMOUS
    assert teacher.session.learner is before
    assert teacher.events(wish.replace("_", " ")) == ["not in the autonomous run: nothing was changed"]


# Insisting


def insisting(paper, **more):
    return taught(paper, correction={"insist_force": 8.0, "insist_time": 0.5, "hold": 1.0}, **more)


@pytest.mark.parametrize("force", [-12.0, 12.0])
def test_a_sustained_effort_takes_control_back_and_forgets_the_place(paper, force):
    teacher = insisting(paper)
    ticks = teacher.teach(1.2, force_z=force, **HERE)
    assert ticks[-1].C == 1.0
    assert len(teacher.events("insist")) == len(teacher.events("forget")) == 1
    begun = next(i for i, tick in enumerate(ticks) if "insist" in dict(tick.events)) * DT
    assert 0.5 < begun < 0.7
    again = teacher.teach_until_update(depth=0.09, **HERE).update
    assert again.learner.query(0.05, 0.05)[0] > 0.07


def test_a_passing_effort_or_a_weak_one_does_not(paper):
    teacher = insisting(paper)
    for _ in range(5):
        teacher.teach(0.4, force_z=-12.0, **HERE)
        teacher.teach(0.2, force_z=0.0, **HERE)
    teacher.teach(2.0, force_z=7.0, **HERE)
    assert {tick.C for tick in teacher.ticks[100:]} == {0.0}
    assert not teacher.events("insist")


def test_pushing_to_and_fro_is_no_insisting(paper):
    teacher = insisting(paper)
    for k in range(8):
        teacher.teach(0.35, force_z=12.0 * (-1) ** k, **HERE)
    assert not teacher.events("insist")


def test_where_the_human_is_in_control_nothing_is_taken_back(paper):
    teacher = Teacher(paper, correction={"insist_force": 5.0}, n_acc=1000)
    teacher.teach(2.0, force_z=-20.0, **HERE)
    assert not teacher.events("insist")


def test_by_default_nobody_insists(paper):
    teacher = taught(paper)
    teacher.teach(3.0, force_z=-25.0, **HERE)
    assert not teacher.events("insist")


def test_he_who_insists_keeps_a_button_pressed_until_the_next_update(paper):
    teacher = Teacher(
        paper,
        learner=plane_learner(),
        arbitration=ButtonArbitration(),
        correction={"insist_force": 8.0, "hold": 0.1},
    )
    assert teacher.teach(1.0, **HERE)[-1].C == 0.0
    teacher.teach(1.0, force_z=-12.0, **HERE)
    assert teacher.session.button
    teacher.teach_until_update(**HERE)
    assert not teacher.session.button
    assert teacher.teach(0.5, **HERE)[-1].C == 0.0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("radius", 0.0),
        ("radius", math.nan),
        ("insist_force", -1.0),
        ("insist_time", math.inf),
        ("hold", -0.1),
        ("undo_steps", -1),
    ],
)
def test_a_correction_out_of_range_names_its_field(name, value):
    with pytest.raises(ConfigurationError) as caught:
        CorrectionOptions(**{name: value})
    assert caught.value.field == name


def test_an_effort_must_last_in_one_direction():
    insistence = Insistence(CorrectionOptions(insist_force=1.0, insist_time=0.1))
    assert not any(insistence.step(2.0, 0.01, is_robot=True) for _ in range(9))
    assert not insistence.step(-2.0, 0.01, is_robot=True)
    assert [insistence.step(-2.0, 0.01, is_robot=True) for _ in range(10)].count(True) == 1


# Nothing jumps

WISHES = st.sampled_from(["forget", "forget_all", "undo", "discard", "teach", "press", ""])
ARBITRATIONS = {
    "existence": ExistenceArbitration,
    "confidence": ConfidenceArbitration,
    "error": ErrorArbitration,
    "success": lambda: SuccessArbitration(force_success(10.0, 3.0)),
    "button": ButtonArbitration,
}


@pytest.mark.parametrize("coupling", Coupling)
@pytest.mark.parametrize("make", ARBITRATIONS.values(), ids=ARBITRATIONS.keys())
@given(wishes=st.lists(st.tuples(WISHES, st.integers(1, 40)), max_size=12), seed=st.integers(0, 100))
@settings(max_examples=8, deadline=None)
def test_whatever_is_forgotten_undone_or_learned_the_command_does_not_jump(
    paper, make, coupling, wishes, seed
):
    rng = np.random.default_rng(seed)
    learner = plane_learner()
    learner.partial_fit(rng.uniform(-0.2, 0.2, (60, 2)), rng.uniform(0.0, 0.15, (60, 1)))
    hand_over = 0.3
    teacher = Teacher(paper, learner=learner, arbitration=make(), coupling=coupling, n_acc=40)
    place = {"depth": 0.06, **HERE}
    teacher.tick(**place)
    for wish, ticks in wishes:
        if wish == "press":
            teacher.session.is_latched = not teacher.session.is_latched
        elif wish == "teach":
            teacher.session.forget(Region(place["x"], place["y"], 0.1))
        elif wish:
            getattr(teacher.session, wish)()
        for _ in range(ticks):
            before, tick = teacher.ticks[-1], teacher.tick(**place)
            # C and the skill's command may each change by the share of a hand-over that a tick is
            span = max(abs(tick.y_demo - tick.y_robot), abs(before.y_demo - before.y_robot))
            assert abs(tick.C - before.C) <= DT / hand_over + 1e-12
            assert abs(tick.y_cmd - before.y_cmd) <= DT / hand_over * (span + 0.2) + 1e-9
