"""The public Python client of the University of Reading, unchanged, over TCP, through all that it offers."""

import time
from urllib.parse import urlsplit

import pytest
from haptic_master.effect import BiasForce, Damper, Shaker, Spring
from haptic_master.haptic_master import HapticMaster
from haptic_master.object import Block, Cylinder, FlatPlane, Sphere, Torus


@pytest.fixture(scope="module")
def robot():
    from emulator import Emulator

    with Emulator(init_seconds=0.3) as emulator:
        parts = urlsplit(emulator.url)
        robot = HapticMaster(parts.hostname, parts.port)
        robot.connect()
        yield robot
        robot.disconnect()


def wait_for(robot: HapticMaster, state: str) -> None:
    deadline = time.monotonic() + 20.0
    while robot.get_state() != state:
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_states_are_set_and_read(robot):
    assert "state set to 'init'" in robot.set_state("init")
    wait_for(robot, "stop")
    for state in ("position", "force", "home", "off"):
        assert f"state set to '{state}'" in robot.set_state(state)
        assert robot.get_state() == state


def test_the_arm_is_calibrated_after_init(robot):
    robot.set_state("init")
    assert not robot.get_position_calibrated()
    wait_for(robot, "stop")
    assert robot.get_position_calibrated()
    assert robot.get_force_calibrated()
    assert robot.calibrateforcesensor()


def test_inertia_and_friction_are_set_and_read(robot):
    assert robot.set_inertia(3.5)
    assert robot.get_inertia() == 3.5
    assert robot.set_coulombfriction(0.25)
    assert robot.get_coulombfriction() == 0.25


@pytest.mark.parametrize(
    "name",
    [
        "measpos",
        "measforce",
        "modelpos",
        "modelvel",
        "modelacc",
        "measposjoint",
        "measforcejoint",
        "modelposjoint",
        "modelveljoint",
        "modelaccjoint",
    ],
)
def test_measurements_are_lists_of_three_numbers(robot, name):
    value = getattr(robot, f"get_{name}")()
    assert len(value) == 3
    assert all(isinstance(component, float) for component in value)


def test_the_workspace_is_that_of_the_arm(robot):
    assert robot.get_workspace_r() == [-0.19, 0.45, 0.19]
    assert robot.get_workspace_phi() == [-0.504, 0.0, 0.507]
    assert robot.get_workspace_z() == [-0.228, 0.0, 0.228]


COMMON = {"pos": [0.1, -0.05, 0.025], "vel": [0.5, 0.0, 0.0], "att": [0.0, 0.0, 1.0, 0.0]}
SURFACE = {
    "stiffness": 20000.0,
    "dampfactor": 0.7,
    "no_pull": True,
    "tang_damping": 2.0,
    "damping_forcemax": 50.0,
    "friction": 0.3,
    "ejection_velmax": 0.25,
    "ejection_damping": 10.0,
    "outward_forcemax": 100.0,
    "powermax": 25.0,
}
SPRING = {
    "stiffness": 2000.0,
    "dampfactor": 1.0,
    "deadband": 0.01,
    "direction": [0.0, 0.0, 1.0],
    "maxforce": 30.0,
}


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (Spring, SPRING | {"dampglobal": True}),
        (Damper, {"dampcoef": [10.0, 20.0, 500.0]}),
        (BiasForce, {"force": [0.0, 1.25, 0.0]}),
        (
            Shaker,
            SPRING | {"frequency1": 2.0, "frequency2": 5.0, "posmax": 0.02, "velmax": 0.5, "accmax": 10.0},
        ),
        (Block, SURFACE | {"size": [0.1, 0.2, 0.05]}),
        (Sphere, SURFACE | {"radius": 0.08}),
        (FlatPlane, SURFACE | {"normal": [0.0, 0.0, 1.0]}),
        (Cylinder, SURFACE | {"radius": 0.05, "length": 0.2}),
        (Torus, SURFACE | {"ringradius": 0.1, "tuberadius": 0.02}),
    ],
)
def test_every_object_is_created_set_read_enabled_and_removed(robot, kind, values):
    thing = kind(f"my_{kind.__name__}", robot)
    assert thing.create()
    assert not thing.get_enabled()
    for name, value in (COMMON | values).items():
        assert getattr(thing, f"set_{name}")(value), name
        assert getattr(thing, f"get_{name}")() == value, name
    assert thing.set_enable()
    assert thing.get_enabled()
    assert thing.set_disable()
    assert not thing.get_enabled()
    assert thing.remove()
    assert not thing.remove()
