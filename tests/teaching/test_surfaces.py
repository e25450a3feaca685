"""Surfaces of any shape: those that are shipped, circles, and arrays."""

import itertools
import math

import numpy as np
import pytest

from hm_driver.errors import ConfigurationError
from hm_driver.geometry import ArmGeometry
from teaching.hands.screen import Screen
from teaching.task_file import format_task, load_task, parse_task, task_names

HEAD = 'name = "mine"\n[plane]\nsize = 0.4\n'
STEP = HEAD + "[array]\nvalues = [[100.0, 100.0, 500.0, 500.0], [100.0, 100.0, 500.0, 500.0]]\n"


@pytest.mark.parametrize("name", task_names())
def test_every_shipped_task_is_in_reach_and_reads_back_from_what_it_writes(name):
    task = load_task(name)
    task.check_reach(ArmGeometry())
    again = parse_task(format_task(task))
    assert again == task
    points = task.grid(30)
    assert np.array_equal(again.stiffness_at(points), task.stiffness_at(points))
    assert 50.0 <= task.stiffness_at(points).min() <= task.stiffness_at(points).max() <= 1000.0


@pytest.mark.parametrize("name", task_names())
def test_the_distance_from_a_border_is_that_of_the_nearest_place_with_another_object(name):
    task = load_task(name)
    pitch = 0.002
    fine = task.grid(200)
    things = np.array([task.object_at(x, y) for x, y in fine.tolist()])
    points = task.grid(12)
    distances = task.border_distances(points)
    for (x, y), distance in zip(points.tolist(), distances.tolist(), strict=True):
        others = fine[things != task.object_at(x, y)]
        if not len(others):
            assert distance == math.inf
            continue
        seen = float(np.min(np.hypot(*(others - (x, y)).T)))
        assert distance == pytest.approx(seen, abs=1.5 * pitch)
        assert distance == pytest.approx(task.border_distance(x, y))


def test_a_circle_has_its_border_at_its_radius():
    task = load_task("curved")
    for turn in np.linspace(0.0, 6.0, 13):
        x, y = 0.05 * math.cos(turn), 0.02 + 0.05 * math.sin(turn)
        assert task.border_distance(x, y) == pytest.approx(0.02, abs=2e-4)
        assert task.stiffness(x, y) == 500.0


# Arrays


def test_a_step_in_an_array_is_a_border_between_two_regions():
    task = parse_task(STEP)
    assert len(task.objects) == 2
    assert task.stiffness(0.0, -0.1) == 100.0
    assert task.stiffness(0.0, 0.1) == 500.0
    assert task.border_segments == (((-0.2, 0.0), (0.2, 0.0)),)
    assert task.object_at(0.1, -0.01) != task.object_at(0.1, 0.01)


def test_beyond_an_array_its_nearest_cell_goes_on_without_an_object():
    task = parse_task(STEP)
    assert task.stiffness(0.0, 0.3) == 500.0
    assert task.object_at(0.0, 0.3) == -1


def test_a_linear_array_is_smooth_and_has_no_border():
    task = parse_task(STEP + 'interpolation = "linear"\n')
    assert task.border_segments == ()
    assert task.stiffness(0.0, 0.0) == pytest.approx(300.0)
    along = [task.stiffness(0.0, y) for y in np.linspace(-0.2, 0.2, 401)]
    assert max(abs(b - a) for a, b in itertools.pairwise(along)) < 5.0


def test_small_differences_are_no_border():
    values = "[[100.0, 110.0], [105.0, 115.0]]"
    assert parse_task(HEAD + f"[array]\nvalues = {values}\n").border_segments == ()
    assert parse_task(HEAD + f"[array]\nvalues = {values}\nborder = 0.01\n").border_segments != ()


@pytest.mark.parametrize("suffix", [".npy", ".csv"])
def test_an_array_is_read_from_a_file_beside_the_task(tmp_path, suffix):
    values = np.array([[100.0, 200.0, 400.0], [100.0, 200.0, 400.0]])
    if suffix == ".npy":
        np.save(tmp_path / "mine.npy", values)
    else:
        (tmp_path / "mine.csv").write_text("# N/m\n100, 200, 400\n100, 200, 400\n")
    path = tmp_path / "mine.toml"
    path.write_text(HEAD + f'[array]\nfile = "mine{suffix}"\n')
    task = load_task(path)
    assert task.stiffness(0.0, 0.19) == 400.0
    assert len(task.objects) == 3
    assert parse_task(format_task(task)) == task


@pytest.mark.parametrize(
    ("text", "field", "problem"),
    [
        ("values = [[100.0, 200.0]]", "array.values", "at least 2 by 2"),
        ("values = [[100.0, 200.0], [100.0]]", "array.values", "rectangle"),
        ("values = [[100.0, 200.0], [100.0, 0.5]]", "array.values", "[1][1] = 0.5 N/m"),
        ("values = [[100.0, nan], [100.0, 200.0]]", "array.values[0][1]", "finite"),
        ("values = 3", "array.values", "list of lists"),
        ("", "array.file", "either"),
        ('file = "none.csv"', "array.file", "cannot be read"),
        ('file = "none.txt"', "array.file", ".npy or a .csv"),
        ("values = [[1.0, 1.0], [1.0, 1.0]]\nextent = [0.0, 0.2, -0.2, 0.2]", "array.extent", "must reach"),
        ("values = [[1.0, 1.0], [1.0, 1.0]]\nextent = [0.2, 0.0, -0.2, 0.2]", "array.extent", "x_min"),
        ('values = [[1.0, 1.0], [1.0, 1.0]]\ninterpolation = "cubic"', "array.interpolation", "nearest"),
        ("values = [[1.0, 1.0], [1.0, 1.0]]\ncolour = 1", "array.colour", "unknown"),
    ],
)  # fmt: skip
def test_a_wrong_array_is_refused_with_its_field(text, field, problem):
    with pytest.raises(ConfigurationError) as caught:
        parse_task(HEAD + "[array]\n" + text + "\n")
    assert field.startswith(caught.value.field)
    assert problem in caught.value.problem


def test_a_noisy_array_is_refused_before_every_cell_is_an_object(rng):
    rows = [[float(v) for v in row] for row in rng.uniform(100.0, 900.0, (20, 20))]
    with pytest.raises(ConfigurationError, match="regions"):
        parse_task(HEAD + f"[array]\nvalues = {rows}\n")


def test_a_damaged_file_is_refused(tmp_path):
    for name, content in (("a.npy", b"no array"), ("a.csv", b"1,2\n3,x\n")):
        (tmp_path / name).write_bytes(content)
        path = tmp_path / "a.toml"
        path.write_text(HEAD + f'[array]\nfile = "{name}"\n')
        with pytest.raises(ConfigurationError) as caught:
            load_task(path)
        assert caught.value.field == "array.file"


def test_a_task_that_is_not_there_is_refused_with_those_that_are():
    for name in ("papr", "none/there.toml"):
        with pytest.raises(
            ConfigurationError, match=r"array, curved, gradient, paper, slanted, steep, turned"
        ):
            load_task(name)


# What is seen of it


@pytest.mark.parametrize("name", ["turned", "slanted", "curved", "array"])
def test_lines_over_a_colour_of_any_shape_stay_on_it_and_reach_all_of_it(name):
    task = load_task(name)
    screen = Screen(task.object_at, 0.5 * task.size)
    for colour in screen.colours:
        path = screen.lines(colour, 0.025, 0.02, start=(0.0, 0.0))
        for (ax, ay), (bx, by) in zip(path[::2], path[1::2], strict=False):
            for t in np.linspace(0.0, 1.0, 9):
                assert task.object_at(ax + t * (bx - ax), ay + t * (by - ay)) == colour


@pytest.mark.parametrize("name", ["paper", "turned", "slanted", "curved", "array"])
def test_a_way_along_an_edge_stays_on_its_colour_near_the_border(name):
    task = load_task(name)
    screen = Screen(task.object_at, 0.5 * task.size)
    for colour in screen.colours:
        way = screen.edge(colour, 0.01, (0.0, 0.0))
        assert way
        assert np.mean([task.object_at(x, y) == colour for x, y in way]) > 0.98
        assert np.median(task.border_distances(way)) == pytest.approx(0.01, abs=0.004)


def test_a_plane_of_one_colour_has_no_edge():
    task = load_task("gradient")
    assert Screen(task.object_at, 0.2).edge(0, 0.01, (0.0, 0.0)) == []
