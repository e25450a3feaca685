"""Every arbitration against the contract, and what each is made for."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hm_driver.errors import ConfigurationError
from teaching.arbitration import (
    ButtonArbitration,
    ConfidenceArbitration,
    ErrorArbitration,
    ExistenceArbitration,
    Observation,
    Query,
    SuccessArbitration,
    blend,
    check_thresholds,
    control_factor,
    force_success,
)

ACTIVATION = st.floats(0.0, 1.0)
ANY = st.floats()
PLACE = st.floats(-0.3, 0.3)
FORCE = 10.0


def observation(x=0.0, y=0.0, **changes):
    values = {
        "y_demo": 0.05,
        "y_robot": 0.05,
        "C": 1.0,
        "force": FORCE,
        "is_demonstrating": True,
        "is_pressed": False,
        "has_skill": True,
        "dt": 0.01,
    }
    return Observation(x, y, **(values | changes))


def success():
    return SuccessArbitration(force_success(FORCE, 1.0))


MAKERS = {
    "existence": ExistenceArbitration,
    "existence as a step": lambda: ExistenceArbitration(0.5, 0.0),
    "confidence": ConfidenceArbitration,
    "error": ErrorArbitration,
    "success": success,
    "button": ButtonArbitration,
}
STATEFUL = {"error": ErrorArbitration, "success": success, "button": ButtonArbitration}
BY_ACTIVATION = {"existence": ExistenceArbitration, "confidence": ConfidenceArbitration, "success": success}


EVERY = pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS.keys())


def after(make, observations):
    arbitration = make()
    for one in observations:
        arbitration.observe(one)
    return arbitration


OBSERVATIONS = st.lists(
    st.builds(
        observation,
        PLACE,
        PLACE,
        y_demo=st.floats(0.0, 0.2),
        y_robot=st.floats(0.0, 0.2),
        C=ACTIVATION,
        force=st.floats(0.0, 100.0),
        is_demonstrating=st.booleans(),
        is_pressed=st.booleans(),
        has_skill=st.booleans(),
        dt=st.floats(0.001, 0.5),
    ),
    max_size=8,
)

# The contract


@EVERY
@settings(max_examples=20, deadline=None)
@given(OBSERVATIONS, ANY, ANY, ANY, ANY, ANY)
def test_the_factor_is_between_0_and_1_for_any_input(make, observations, y_robot, w_max, std, x, y):
    C = after(make, observations).factor(Query(y_robot, w_max, std, x, y))
    assert 0.0 <= C <= 1.0


@EVERY
@given(ANY, ANY, PLACE, PLACE)
def test_at_the_beginning_and_where_no_model_is_the_human_is_alone_in_control(make, y_robot, std, x, y):
    assert make().factor(Query(y_robot, 0.0, std, x, y)) == 1.0


@EVERY
def test_asking_changes_nothing(make):
    arbitration = make()
    query = Query(0.05, 0.6, 0.001, 0.01, 0.02)
    assert arbitration.factor(query) == arbitration.factor(query)


@EVERY
def test_forgetting_goes_no_higher_than_the_threshold_of_coverage(make):
    arbitration = make()
    assert 0.0 < arbitration.w_free <= arbitration.w_th == 0.5


@EVERY
@settings(max_examples=20, deadline=None)
@given(OBSERVATIONS, OBSERVATIONS, ACTIVATION, PLACE, PLACE)
def test_a_copy_goes_its_own_way(make, before, later, w_max, x, y):
    query = Query(0.05, w_max, 0.001, x, y)
    arbitration = after(make, before)
    C = arbitration.factor(query)
    twin = arbitration.copy()
    assert twin.factor(query) == C
    for one in later:
        twin.observe(one)
    assert arbitration.factor(query) == C
    for one in later:
        arbitration.observe(one)
    assert arbitration.factor(query) == twin.factor(query)


@EVERY
@settings(max_examples=20, deadline=None)
@given(OBSERVATIONS, ACTIVATION, PLACE, PLACE)
def test_a_reset_arbitration_is_as_a_new_one(make, observations, w_max, x, y):
    arbitration = after(make, observations)
    arbitration.reset()
    query = Query(0.05, w_max, 0.001, x, y)
    assert arbitration.factor(query) == make().factor(query)


@pytest.mark.parametrize("make", [v for k, v in MAKERS.items() if k not in STATEFUL])
@settings(max_examples=20, deadline=None)
@given(OBSERVATIONS, ACTIVATION)
def test_one_without_state_decides_by_the_query_alone(make, observations, w_max):
    query = Query(0.05, w_max, 0.004)
    assert not make().is_stateful
    assert after(make, observations).factor(query) == make().factor(query)


@pytest.mark.parametrize("make", STATEFUL.values(), ids=STATEFUL.keys())
def test_those_that_must_be_told_say_so(make):
    assert make().is_stateful


@EVERY
@settings(max_examples=20, deadline=None)
@given(OBSERVATIONS)
def test_observing_in_any_order_stays_finite(make, observations):
    arbitration = after(make, observations + observations)
    assert math.isfinite(arbitration.factor(Query(0.0, 1.0, 0.0)))


@pytest.mark.parametrize("make", BY_ACTIVATION.values(), ids=BY_ACTIVATION.keys())
@given(ACTIVATION, ACTIVATION, PLACE, PLACE)
def test_more_activation_never_gives_the_human_more(make, a, b, x, y):
    low, high = sorted((a, b))
    arbitration = after(make, [observation(x, y, dt=10.0)])
    assert arbitration.factor(Query(0.05, low, 0.0, x, y)) >= arbitration.factor(Query(0.05, high, 0.0, x, y))


@pytest.mark.parametrize("make", BY_ACTIVATION.values(), ids=BY_ACTIVATION.keys())
@given(ACTIVATION, st.floats(-1e-6, 1e-6), st.floats(0.0, 0.1), st.floats(-1e-6, 1e-6))
def test_the_factor_is_continuous_in_activation_and_doubt(make, w_max, step, std, change):
    arbitration = make()
    jump = arbitration.factor(Query(0.05, w_max + step, abs(std + change))) - arbitration.factor(
        Query(0.05, w_max, std)
    )
    slope = 0.5 * math.pi / 0.05
    assert abs(jump) <= slope * abs(step) + 0.5 * math.pi / 0.1 * abs(change) / 0.05 + 1e-12


# Eqs. (8) and (9)


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


# Confidence


def test_confidence_gives_control_back_where_the_skill_is_in_doubt():
    arbitration = ConfidenceArbitration()
    assert arbitration.needs_std
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


# Error


def test_the_average_error_gives_the_skill_control_as_it_falls():
    arbitration = ErrorArbitration(alone=0.5, done=0.1, memory=1.0)
    anywhere = Query(0.05, 0.0)
    for _ in range(300):
        arbitration.observe(observation(y_robot=0.0))
    assert arbitration.error == pytest.approx(1.0)
    assert arbitration.factor(anywhere) == 1.0
    shares = []
    for _ in range(1000):
        arbitration.observe(observation(y_robot=0.051))
        shares.append(arbitration.factor(anywhere))
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] == 0.0


def test_without_fading_all_ticks_count_the_same():
    arbitration = ErrorArbitration(memory=math.inf)
    for k in range(10):
        arbitration.observe(observation(y_demo=0.1, y_robot=0.1 * (k % 2)))
    assert arbitration.error == pytest.approx(0.5)


def test_what_is_no_demonstration_does_not_count():
    arbitration = ErrorArbitration()
    arbitration.observe(observation(y_robot=0.0, is_demonstrating=False))
    arbitration.observe(observation(y_robot=math.nan))
    assert arbitration.error == math.inf


@pytest.mark.parametrize(
    "arguments", [{"alone": 0.1, "done": 0.1}, {"done": -0.1}, {"memory": 0.0}, {"memory": math.nan}]
)
def test_an_average_out_of_range_is_refused(arguments):
    with pytest.raises(ConfigurationError):
        ErrorArbitration(**arguments)


# Success


def test_success_gives_the_skill_control_where_it_was_seen_and_nowhere_else():
    arbitration = success()
    for _ in range(200):
        for x in (-0.02, 0.02):
            for y in (-0.02, 0.02):
                arbitration.observe(observation(x, y))
    assert arbitration.factor(Query(0.05, 1.0, 0.0, 0.0, 0.0)) == 0.0
    assert arbitration.factor(Query(0.05, 1.0, 0.0, 0.15, 0.15)) == 1.0
    assert arbitration.factor(Query(0.05, 0.3, 0.0, 0.0, 0.0)) == 1.0
    arbitration.forget(0.0, 0.0, 0.01)
    assert arbitration.factor(Query(0.05, 1.0, 0.0, 0.0, 0.0)) == 1.0


@given(PLACE, PLACE, st.floats(-1e-5, 1e-5), st.floats(-1e-5, 1e-5))
def test_the_local_success_is_continuous_over_the_plane(x, y, dx, dy):
    arbitration = success()
    for k in range(400):
        place = 0.2 * math.sin(k), 0.2 * math.cos(1.7 * k)
        arbitration.observe(observation(*place, force=FORCE + 3.0 * math.sin(0.1 * k), dt=0.3))
    jump = arbitration.local_success(x + dx, y + dy) - arbitration.local_success(x, y)
    assert abs(jump) <= 8.0 * (abs(dx) + abs(dy)) / arbitration.cell + 1e-12


@given(st.floats(0.0, 100.0))
def test_success_at_a_force_is_full_within_the_tolerance_and_none_at_twice_of_it(force):
    value = force_success(10.0, 2.0)(observation(force=force))
    off = abs(force - 10.0)
    assert value == (1.0 if off <= 2.0 else 0.0 if off >= 4.0 else pytest.approx(2.0 - off / 2.0))


def test_a_success_that_is_none_is_refused():
    with pytest.raises(ValueError, match="between 0 and 1"):
        SuccessArbitration(lambda _: 1.5).observe(observation())


@pytest.mark.parametrize(
    "arguments", [{"low": 0.9, "high": 0.9}, {"high": 1.0}, {"memory": 0.0}, {"cell": 0.0}, {"w_th": 0.0}]
)
def test_a_success_out_of_range_is_refused(arguments):
    with pytest.raises(ConfigurationError):
        SuccessArbitration(force_success(10.0, 1.0), **arguments)


# Button


def test_the_button_decides_once_there_is_a_skill():
    arbitration = ButtonArbitration()
    arbitration.observe(observation(has_skill=False))
    assert arbitration.factor(Query(0.05, 0.0)) == 1.0
    arbitration.observe(observation())
    assert arbitration.factor(Query(0.05, 0.0)) == 0.0
    arbitration.observe(observation(is_pressed=True))
    assert arbitration.factor(Query(0.05, 1.0)) == 1.0
