import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hm_driver.errors import ConfigurationError
from teaching.arbitration import (
    ConfidenceArbitration,
    ExistenceArbitration,
    Query,
    blend,
    check_thresholds,
    control_factor,
)

ACTIVATION = st.floats(0.0, 1.0)


@given(ACTIVATION, st.floats(0.05, 0.95), st.floats(0.0, 0.09))
def test_the_factor_is_1_below_the_switch_and_0_above_it(w_max, w_th, d):
    C = control_factor(w_max, w_th=w_th, d=d)
    assert 0.0 <= C <= 1.0
    if w_max < w_th - d / 2:
        assert C == 1.0
    if w_max >= w_th + d / 2:
        assert C == 0.0


@given(ACTIVATION, ACTIVATION)
def test_the_factor_falls_monotonically(a, b):
    low, high = sorted((a, b))
    assert control_factor(low, w_th=0.5, d=0.05) >= control_factor(high, w_th=0.5, d=0.05)


@given(ACTIVATION, st.floats(-1e-6, 1e-6))
def test_the_factor_is_continuous(w_max, step):
    jump = abs(control_factor(w_max + step, w_th=0.5, d=0.05) - control_factor(w_max, w_th=0.5, d=0.05))
    assert jump <= 0.5 * math.pi / 0.05 * abs(step) + 1e-12


def test_the_factor_is_one_half_at_the_threshold():
    assert control_factor(0.5, w_th=0.5, d=0.05) == pytest.approx(0.5)


def test_a_switch_of_no_width_is_a_step():
    assert control_factor(0.4999, w_th=0.5, d=0.0) == 1.0
    assert control_factor(0.5, w_th=0.5, d=0.0) == 0.0


@given(st.floats(0.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_the_command_lies_between_human_and_skill(C, y_demo, y_robot):
    y = blend(C, y_demo, y_robot)
    assert min(y_demo, y_robot) - 1e-12 <= y <= max(y_demo, y_robot) + 1e-12


def test_full_control_is_exact():
    assert blend(1.0, 0.1, 0.7) == 0.1
    assert blend(0.0, 0.1, 0.7) == 0.7


def test_existence_gives_control_to_the_skill_where_a_model_is():
    arbitration = ExistenceArbitration()
    assert arbitration.factor(Query(0.1, 0.0)) == 1.0
    assert arbitration.factor(Query(0.1, 0.9)) == 0.0


@pytest.mark.parametrize(
    ("w_th", "d", "field"),
    [(0.0, 0.0, "w_th"), (1.0, 0.0, "w_th"), (0.5, -0.1, "d"), (0.1, 0.2, "d"), (0.9, 0.2, "d")],
)
def test_a_switch_beyond_0_to_1_is_refused(w_th, d, field):
    with pytest.raises(ConfigurationError) as caught:
        ExistenceArbitration(w_th, d)
    assert caught.value.field == field


def test_thresholds_that_contradict_each_other_are_said():
    assert check_thresholds(w_th=0.5, d=0.05, w_gen=0.8) == []
    assert "no model is made there" in check_thresholds(w_th=0.85, d=0.05, w_gen=0.8)[0]
    assert "never the robot's alone" in check_thresholds(w_th=0.79, d=0.05, w_gen=0.8)[0]


ARBITRATIONS = [ExistenceArbitration(), ConfidenceArbitration(), ExistenceArbitration(0.5, 0.0)]


@pytest.mark.parametrize("arbitration", ARBITRATIONS)
@given(st.floats(-1.0, 1.0), ACTIVATION, st.floats(0.0, math.inf))
def test_every_arbitration_gives_a_share_between_0_and_1(arbitration, y_robot, w_max, std):
    assert 0.0 <= arbitration.factor(Query(y_robot, w_max, std)) <= 1.0
    assert arbitration.factor(Query(y_robot, 0.0, std)) == 1.0
    assert arbitration.w_th == 0.5


def test_confidence_gives_control_back_where_the_skill_is_in_doubt():
    arbitration = ConfidenceArbitration()
    assert arbitration.factor(Query(0.1, 0.9, 0.005)) == 0.0
    assert arbitration.factor(Query(0.1, 0.9, 0.02)) == pytest.approx(0.5)
    assert arbitration.factor(Query(0.1, 0.9, 0.05)) == 1.0
    assert arbitration.factor(Query(0.1, 0.3, 0.005)) == 1.0
    assert arbitration.factor(Query(0.0, 0.9, math.inf)) == 1.0


@given(st.floats(0.0, 0.1), st.floats(0.0, 0.1))
def test_more_doubt_never_gives_the_human_less(a, b):
    low, high = sorted((a, b))
    arbitration = ConfidenceArbitration()
    assert arbitration.factor(Query(0.1, 0.9, low)) <= arbitration.factor(Query(0.1, 0.9, high))


@pytest.mark.parametrize(
    "arguments", [{"doubt": 0.0}, {"doubt_width": 1.0}, {"doubt_width": -0.1}, {"w_th": 2.0}]
)
def test_a_doubt_out_of_range_is_refused(arguments):
    with pytest.raises(ConfigurationError):
        ConfidenceArbitration(**arguments)
