import math

import numba
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hm_driver.errors import ProtocolError
from hm_driver.protocol.numbers import format_number, format_vector, round_wire

finite = st.floats(allow_nan=False, allow_infinity=False)
physical = st.floats(min_value=-1e250, max_value=1e250).filter(lambda x: x == 0.0 or abs(x) > 1e-250)
near_a_tie = st.builds(
    lambda digits, exponent, factor: float(f"{digits}5e{exponent}") * factor,
    st.integers(100_000, 999_999),
    st.integers(-30, 20),
    st.sampled_from([1.0, 1.0 - 2.0**-53, 1.0 + 2.0**-52]),
)

compiled_round_wire = numba.njit(round_wire)


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (0.0, "0"),
        (3.0, "3"),
        (0.1 + 0.2, "0.3"),
        (1234567.0, "1.23457e+06"),
        (-0.00001234567, "-1.23457e-05"),
        (100000.0, "100000"),
    ],
)
def test_numbers_look_as_c_prints_them(number, text):
    assert format_number(number) == text


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_not_finite_are_refused(number):
    with pytest.raises(ProtocolError, match="finite"):
        format_number(number)
    with pytest.raises(ProtocolError, match="finite"):
        format_vector((0.0, number, 0.0))
    with pytest.raises(ProtocolError, match="finite"):
        format_vector((0.0, 0.0, 0.0, number))


def test_opposite_infinities_do_not_cancel():
    with pytest.raises(ProtocolError):
        format_vector((math.inf, -math.inf, 0.0))


def test_huge_components_whose_sum_overflows_are_still_finite():
    assert format_vector((1e308, 1e308, 0.0)) == "[1e+308,1e+308,0]"


@given(physical | near_a_tie)
@example(1.000005)
@example(100000.5)
@example(9.9999949999999999)
@example(999999.5)
@settings(max_examples=500)
def test_rounding_equals_printing_and_reading(x):
    assert round_wire(x) == float("%.6g" % x)  # noqa: UP031 - this is the format in question


@given(physical | near_a_tie)
@settings(max_examples=200, deadline=None)  # the first example waits for the compiler
def test_compiled_rounding_equals_interpreted_rounding(x):
    assert compiled_round_wire(x) == round_wire(x)


@given(physical)
def test_rounding_twice_is_rounding_once(x):
    assert round_wire(round_wire(x)) == round_wire(x)


@given(finite)
def test_rounding_never_moves_a_number_by_more_than_half_a_digit(x):
    assert round_wire(x) == pytest.approx(x, rel=5.01e-6, abs=0.0)


def test_rounding_leaves_what_is_not_a_number_alone():
    assert math.isnan(round_wire(math.nan))
    assert round_wire(math.inf) == math.inf
    assert round_wire(0.0) == 0.0
