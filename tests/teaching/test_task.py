import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hm_driver.errors import ConfigurationError
from hm_driver.geometry import ArmGeometry
from teaching.surface import SurfaceObject
from teaching.task import Task
from teaching.task_file import format_task, load_task, parse_task, task_from_dict, task_names

SQUARE = ((-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2))
PLANE = SurfaceObject(name="all", outline=SQUARE, stiffness=200.0, colour="blue")


def test_the_papers_surface_has_its_four_stiffnesses(paper):
    assert sorted(thing.stiffness for thing in paper.objects) == [100.0, 150.0, 300.0, 500.0]
    assert (paper.size, paper.reference_force) == (0.4, 10.0)
    corners = [paper.stiffness(x, y) for x, y in ((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1))]
    assert corners == [100.0, 150.0, 500.0, 300.0]
    assert [paper.object_at(x, y) for x, y in ((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1))] == [
        0,
        1,
        2,
        3,
    ]


def test_the_colours_differ_and_have_names(paper):
    assert len({thing.hex for thing in paper.objects}) == 4
    assert paper.objects[0].colour == "sky blue"


@given(st.floats(-0.15, 0.15), st.floats(-0.15, 0.15), st.floats(-0.2, 0.2))
def test_the_mapping_and_its_inverse_agree(x, y, z):
    task = load_task("paper")
    there = task.to_manipulator(x, y, z)
    np.testing.assert_allclose(task.to_handle(*there), (x, y, z), atol=1e-12)
    assert task.depth(z) == pytest.approx(task.surface_z - there[2], abs=1e-12)
    assert task.handle_z(task.depth(z)) == pytest.approx(z, abs=1e-12)


def test_the_plane_is_larger_than_the_handles_square(paper):
    assert paper.to_manipulator(0.1 + paper.offset[0], 0.0, 0.06)[0] == pytest.approx(0.13)


@given(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))
def test_contact_presses_with_stiffness_times_depth(x, y, z_r):
    contact = load_task("paper").contact(x, y, z_r)
    assert contact.depth == max(0.0, -z_r)
    assert contact.force == pytest.approx(contact.stiffness * contact.depth)
    assert contact.force == pytest.approx(contact.stiffness * (contact.z_a - z_r))
    assert contact.z_a == max(0.0, z_r)


def test_the_required_depth_produces_the_reference_force(paper):
    for x, y in paper.grid(10):
        assert paper.contact(x, y, -paper.required_depth(x, y)).force == pytest.approx(10.0)
    assert paper.depth_max == pytest.approx(0.12)


def test_beyond_the_edge_stiffness_goes_on_but_no_object_is_there(paper):
    assert paper.stiffness(-0.25, -0.1) == 100.0
    assert paper.object_at(-0.25, -0.1) == -1
    assert paper.object_at(0.0, 0.2001) == -1


def test_the_grid_lies_in_the_middle_of_equal_cells(paper):
    grid = paper.grid()
    assert grid.shape == (6400, 2)
    assert grid.min() == pytest.approx(-0.1975)
    assert grid.max() == pytest.approx(0.1975)
    np.testing.assert_allclose(grid[1] - grid[0], (0.0, 0.005), atol=1e-12)


def test_the_borders_are_the_two_middle_lines(paper):
    for x, y in ((0.03, 0.1), (-0.15, -0.02), (0.1, 0.0), (-0.2, -0.2), (0.01, -0.01)):
        assert paper.border_distance(x, y) == pytest.approx(min(abs(x), abs(y)), abs=1e-12)


def test_a_turned_surface_has_turned_borders():
    turned, angle = load_task("turned"), math.radians(20.0)
    for x, y in ((0.1, 0.02), (-0.12, 0.07), (0.03, -0.15)):
        across = -math.sin(angle) * x + math.cos(angle) * y
        along = math.cos(angle) * x + math.sin(angle) * y
        assert turned.border_distance(x, y) == pytest.approx(min(abs(across), abs(along)), abs=1e-9)
        assert turned.stiffness(x, y) == load_task("paper").stiffness(along, across)


def test_one_object_alone_has_no_border():
    assert Task(name="one", objects=(PLANE,)).border_distance(0.0, 0.0) == math.inf


def test_objects_lie_on_earlier_ones_and_hidden_edges_are_no_borders():
    corners = ((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1))
    low = SurfaceObject(name="low", outline=corners, stiffness=100.0, colour="orange")
    lid = SurfaceObject(name="lid", outline=SQUARE, stiffness=300.0, colour="green")
    assert Task(name="seen", objects=(PLANE, low)).stiffness(0.0, 0.0) == 100.0
    assert Task(name="seen", objects=(PLANE, low)).border_distance(0.0, 0.0) == pytest.approx(0.1)
    assert Task(name="hidden", objects=(low, lid)).border_segments == ()


def test_a_polygon_may_be_of_any_shape():
    star = (
        (0.0, 0.15),
        (0.04, 0.04),
        (0.15, 0.0),
        (0.04, -0.04),
        (0.0, -0.15),
        (-0.04, -0.04),
        (-0.15, 0.0),
        (-0.04, 0.04),
    )
    task = Task(
        name="star",
        objects=(PLANE, SurfaceObject(name="star", outline=star, stiffness=400.0, colour="#123abc")),
    )
    assert task.stiffness(0.12, 0.005) == 400.0
    assert task.stiffness(0.1, 0.1) == 200.0
    assert task.objects[1].hex == "#123abc"


def test_stiffness_may_change_within_an_object():
    slope = SurfaceObject(name="slope", outline=SQUARE, stiffness=200.0, gradient=(500.0, 0.0), colour="blue")
    task = Task(name="slope", objects=(slope,))
    assert task.stiffness(0.1, 0.0) == pytest.approx(250.0)
    assert task.depth_max == pytest.approx(1.2 * 10.0 / task.stiffness(-0.195, 0.0))


def test_every_task_of_the_package_is_within_reach_of_the_arm():
    for name in task_names():
        load_task(name).check_reach(ArmGeometry())


@pytest.mark.parametrize(
    ("geometry", "limit"),
    [
        (ArmGeometry(z_min=-0.05), "z"),
        (ArmGeometry(z_max=0.08), "z"),
        (ArmGeometry(r_max=0.15), "r"),
        (ArmGeometry(phi_max=0.4), "phi"),
        (ArmGeometry(r_min=-0.1), "r"),
    ],
)
def test_a_task_out_of_reach_is_refused_with_the_corner_and_the_limit(paper, geometry, limit):
    with pytest.raises(ConfigurationError, match=rf"(corner|edge) x = -?0\.?2?.*{limit} = .* is outside"):
        paper.check_reach(geometry)


def test_a_task_with_an_objectless_spot_is_refused():
    half = SurfaceObject(
        name="half",
        outline=((-0.2, -0.2), (0.0, -0.2), (0.0, 0.2), (-0.2, 0.2)),
        stiffness=100.0,
        colour="blue",
    )
    with pytest.raises(ConfigurationError, match="fill the plane"):
        Task(name="gap", objects=(half,))


def test_a_task_survives_its_own_file():
    for name in task_names():
        task = load_task(name)
        assert parse_task(format_task(task)) == task
        assert task_from_dict(task.to_dict()) == task


TEXT = """
name = "t"
[plane]
size = 0.4
[[objects]]
name = "a"
colour = "blue"
stiffness = 100.0
rectangle = [-0.2, -0.2, 0.2, 0.2]
"""


@pytest.mark.parametrize(
    ("old", "new", "field", "problem"),
    [
        ("size = 0.4", "sise = 0.4", "plane.sise", "known here: size"),
        ("size = 0.4", "size = 40.0", "plane.size", "0.01 to 2 m"),
        ("size = 0.4", "size = true", "plane.size", "number"),
        ("size = 0.4", "size = nan", "plane.size", "finite"),
        ("stiffness = 100.0", "stiffness = 0.0", "objects[0].stiffness", "1 to 100000 N/m"),
        ("stiffness = 100.0", "stiffness = 'soft'", "objects[0].stiffness", "number"),
        ("stiffness = 100.0", "", "objects[0].stiffness", "missing"),
        ('colour = "blue"', 'colour = "pink"', "objects[0].colour", "sky blue"),
        (
            "rectangle = [-0.2, -0.2, 0.2, 0.2]",
            "rectangle = [0.2, -0.2, -0.2, 0.2]",
            "objects[0].rectangle",
            "x_min",
        ),
        (
            "rectangle = [-0.2, -0.2, 0.2, 0.2]",
            "rectangle = [-0.2, -0.2]",
            "objects[0].rectangle",
            "4 numbers",
        ),
        ("rectangle = [-0.2, -0.2, 0.2, 0.2]", "", "objects[0].rectangle", "give one of"),
        ("rectangle = [-0.2, -0.2, 0.2, 0.2]", "polygon = [[0, 0], [1, 1]]", "objects[0].polygon", "three"),
        ("rectangle = [-0.2, -0.2, 0.2, 0.2]", "polygon = [0, 0]", "objects[0].polygon", "list"),
        ('name = "t"', "name = 3", "name", "text"),
        ("[plane]", "[planes]", "planes", "unknown"),
        ("[plane]", "plane = 3\n[x]", "plane", "table"),
        ('name = "t"', 'name = "t', "task", "TOML"),
    ],
)
def test_a_wrong_task_file_is_refused_with_field_and_file(old, new, field, problem):
    with pytest.raises(ConfigurationError) as caught:
        parse_task(TEXT.replace(old, new, 1), source="my.toml")
    assert caught.value.field == field
    assert problem in caught.value.problem
    assert caught.value.source == "my.toml"


def test_a_task_without_objects_is_refused():
    with pytest.raises(ConfigurationError, match="objects"):
        parse_task('name = "t"\nobjects = []')


def test_an_unknown_task_is_refused_with_those_there_are(tmp_path):
    with pytest.raises(ConfigurationError, match="paper"):
        load_task("papre")
    with pytest.raises(ConfigurationError, match=r"none\.toml"):
        load_task(tmp_path / "none.toml")


def test_a_task_is_read_from_a_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(TEXT)
    assert load_task(path).stiffness(0.0, 0.0) == 100.0
    assert load_task(str(path)).name == "t"
