import math

import numpy as np
import pytest

from teaching.evaluation import by_border, coverage, force_error
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
