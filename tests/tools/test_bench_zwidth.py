import math

import pytest

from emulator.parameters import load_parameters
from tools.bench.stability import SOFTEST, STIFFEST, Setting, is_stable, quiet, stiffest
from tools.bench.zwidth import Curve, Panel, draw, table

ARM = quiet(load_parameters())


@pytest.mark.parametrize("limit", [1.5e3, 47e3, 999e3])
def test_bisection_finds_the_limit_from_below_within_three_percent(limit):
    found = stiffest(lambda stiffness: stiffness < limit)
    assert limit / 1.03 <= found < limit


def test_the_limit_is_the_lowest_where_stiffer_ones_are_stable_again():
    assert stiffest(lambda stiffness: not 40e3 < stiffness < 400e3) == pytest.approx(40e3, rel=0.03)


def test_outside_the_range_searched_the_limit_is_none_or_all():
    assert stiffest(lambda _: False) == 0.0
    assert stiffest(lambda stiffness: stiffness <= STIFFEST) == math.inf
    assert SOFTEST < STIFFEST


@pytest.mark.parametrize("damping_ratio", [0.0, 0.7])
@pytest.mark.parametrize("mass", [2.0, 8.0])
def test_a_firm_grip_on_the_stiffest_wall_that_the_device_accepts_is_stable(mass, damping_ratio):
    setting = Setting(mass=mass, hand_stiffness=2e3, wall=200e3, damping_ratio=damping_ratio)
    assert is_stable(ARM, setting)


def test_a_stiff_hand_shakes_too_light_a_virtual_mass_and_damping_of_the_wall_stops_it():
    light = Setting(mass=0.4, hand_stiffness=10e3, wall=100e3)
    assert not is_stable(ARM, light)
    assert is_stable(ARM, Setting(mass=0.4, hand_stiffness=10e3, wall=100e3, damping_ratio=0.7))
    assert is_stable(ARM, Setting(mass=3.0, hand_stiffness=10e3, wall=100e3))


def test_the_picture_is_the_same_every_time_and_the_table_has_its_numbers(tmp_path):
    masses = (0.2, 2.0)
    panels = [Panel("no wall", "hand", (Curve("damped", (3290.0, math.inf)),))] * 4
    first, second = tmp_path / "first.svg", tmp_path / "second.svg"
    draw(panels, first, masses)
    draw(panels, second, masses)
    assert first.read_bytes() == second.read_bytes()
    lines = table(panels, masses)
    assert lines[1].split() == ["0.2", "2"]
    assert lines[3].split() == ["damped", "3.29", ">1000"]
