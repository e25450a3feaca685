import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teaching.evaluation import (
    OnGrid,
    Trace,
    auc,
    by_border,
    coverage,
    evaluate,
    force_error,
    judge,
)
from teaching.lwr import LWR
from teaching.surface import SurfaceObject
from teaching.task import Task


def test_coverage_is_the_share_of_the_grid_with_an_activation_of_at_least_w_th(paper, rng):
    skill = LWR().partial_fit(rng.uniform(-0.2, 0.05, (200, 2)), np.zeros(200))
    expected = np.mean(skill.w_max(paper.grid()) >= 0.5)
    assert 0.1 < expected < 0.9
    assert coverage(skill, paper, 0.5) == expected


def test_nothing_is_covered_before_the_first_update(paper):
    assert coverage(LWR(), paper, 0.5) == 0.0


def test_the_force_error_of_an_unlearned_plane_is_the_reference_force(paper):
    error = force_error(LWR(), paper)
    assert error.overall == error.inside == error.border == (10.0, 10.0, 10.0)


def test_the_error_inside_is_small_and_at_the_border_large(paper, rng):
    X = rng.uniform(-0.2, 0.2, (5000, 2))
    error = force_error(LWR().partial_fit(X, 10.0 / paper.stiffness_at(X)), paper)
    assert error.inside.mean < 1.0 < 3.0 < error.border.mean
    assert error.inside.mean < error.overall.mean < error.border.mean


def test_a_plane_without_borders_is_all_inside():
    outline = ((-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2))
    plane = SurfaceObject(name="all", outline=outline, stiffness=200.0, colour="blue")
    error = force_error(LWR(), Task(name="one", objects=(plane,)))
    assert error.inside == error.overall
    assert math.isnan(error.border.mean)


def test_errors_are_split_by_their_distance_from_the_border():
    error = by_border(np.array([1.0, 2.0, 4.0]), np.array([0.05, 0.03, 0.02]))
    assert (error.inside.mean, error.border.mean) == (1.0, 4.0)
    assert error.overall.mean == pytest.approx(7.0 / 3.0)


# The prediction of what is wrong


def brute_force_auc(score, positive):
    pairs = [(p, q) for p, a in zip(score, positive, strict=True) if a
             for q, b in zip(score, positive, strict=True) if not b]  # fmt: skip
    return sum((p > q) + 0.5 * (p == q) for p, q in pairs) / len(pairs) if pairs else math.nan


SCORES = st.lists(
    st.tuples(
        st.one_of(st.integers(0, 4).map(float), st.floats(-1e6, 1e6), st.just(math.inf)), st.booleans()
    ),
    min_size=1,
    max_size=40,
)


@given(SCORES)
def test_the_area_is_that_of_comparing_every_pair(pairs):
    score, positive = [s for s, _ in pairs], [p for _, p in pairs]
    assert auc(score, positive) == pytest.approx(brute_force_auc(score, positive), nan_ok=True)


def test_a_perfect_score_has_an_area_of_1_and_a_constant_one_of_a_half():
    wrong = np.array([False, False, True, True])
    assert auc([1.0, 2.0, 3.0, 4.0], wrong) == 1.0
    assert auc([4.0, 3.0, 2.0, 1.0], wrong) == 0.0
    assert auc(np.ones(4), wrong) == 0.5


def test_a_score_that_is_no_number_or_of_another_shape_is_refused():
    with pytest.raises(ValueError, match=r"score\[1\] is NaN"):
        auc([0.0, math.nan], [True, False])
    with pytest.raises(ValueError, match="shape"):
        auc([0.0, 1.0], [True])


# A whole session


def trace_of(stage, C, recorded, *, force=10.0, x=-0.1, y=-0.1):
    n = len(stage)
    return Trace(
        0.01 * np.arange(n), np.array(stage), np.array(C, dtype=float), np.array(recorded, dtype=bool),
        np.full(n, x), np.full(n, y), np.broadcast_to(np.asarray(force, dtype=float), n).copy(),
    )  # fmt: skip


def test_teaching_is_counted_from_the_first_sample(paper):
    trace = trace_of([0, 1, 1, 1, 1, 2], [1, 1, 1, 0, 0, 0], [0, 0, 1, 0, 0, 0])
    figures = evaluate(paper, judge(LWR(), paper), trace)
    assert figures.teaching_s == pytest.approx(0.03)
    assert figures.human_share == pytest.approx(1.0 / 3.0)
    assert figures.hand_overs == 1


def test_the_run_is_judged_where_the_manipulator_is_on_the_plane(paper):
    trace = trace_of([2, 2, 2], [0, 0, 0], [0, 0, 0], force=[9.0, 11.0, 40.0])
    trace.x[2] = 0.21
    run = evaluate(paper, judge(LWR(), paper), trace).run
    assert run.overall.mean == pytest.approx(1.0)
    assert math.isnan(run.border.mean)


def test_a_session_without_a_tick_has_an_error_on_the_grid_alone(paper):
    figures = evaluate(paper, judge(LWR(), paper), Trace.empty())
    assert figures.grid.overall.mean == 10.0
    assert figures.share_wrong == 1.0
    assert figures.teaching_s == 0.0
    assert figures.as_dict()["run"]["overall"]["mean"] is None
    assert figures.as_dict()["auc_std"] is None


def test_the_deviation_tells_wrong_places_where_the_activation_does_not(paper, rng):
    X = rng.uniform(-0.2, 0.2, (5000, 2))
    figures = evaluate(paper, judge(LWR().partial_fit(X, 10.0 / paper.stiffness_at(X)), paper), Trace.empty())
    assert figures.coverage == 1.0
    assert figures.auc_std > 0.7
    assert 0.3 < figures.auc_w_max < 0.7


def test_a_skill_without_deviation_has_no_area_by_it(paper):
    n = len(paper.grid())
    figures = evaluate(paper, OnGrid(np.full(n, 10.0 / 150.0), np.ones(n)), Trace.empty())
    assert math.isnan(figures.auc_std)
    assert figures.auc_w_max == 0.5
