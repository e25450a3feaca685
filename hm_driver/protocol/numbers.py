"""How a number looks on the wire: six significant digits, as C's ``%g`` prints them."""

import math
from collections.abc import Sequence

from hm_driver.errors import ProtocolError

SIGNIFICANT_DIGITS = 6
"""Digits that the device prints (device facts, confidence H)."""

_POWERS_OF_TEN = tuple(float(10**exponent) for exponent in range(23))
_LARGEST_POWER = 22
_SPLITTER = 134217729.0
_SMALLEST = 1e-250
_LARGEST = 1e250


def format_number(x: float) -> str:
    """Print a number as C's ``%g``.

    Raises:
        ProtocolError: The number is NaN or infinite; the wire carries finite numbers only.
    """
    if x - x != 0.0:
        raise ProtocolError(f"{x} cannot be sent: the protocol carries finite numbers only")
    return "%g" % x  # noqa: UP031 - half the time of an f-string


def format_vector(components: Sequence[float]) -> str:
    """Print a vector or quaternion as ``[a,b,c]``, without blanks.

    Raises:
        ProtocolError: A component is NaN or infinite.
    """
    if len(components) == 3:
        x, y, z = components
        total = x + y + z
        if total - total == 0.0:
            return "[%g,%g,%g]" % (x, y, z)  # noqa: UP031 - half the time of an f-string
    return f"[{','.join([format_number(component) for component in components])}]"


def round_wire(x: float) -> float:
    """Round to the double that a reader of ``%.6g`` gets, in plain arithmetic that a kernel can compile.

    One function without calls of its own, so that it compiles as it stands. The scaled value is kept as an
    unevaluated sum high + low of two doubles (Dekker 1971), so that values next to a tie, and ties, fall on
    the side where the decimal expansion falls. Values outside 1e-250 to 1e250 in magnitude, which nothing
    physical reaches, and NaN are returned as they are.
    """
    magnitude = abs(x)
    if not (_SMALLEST < magnitude < _LARGEST):
        return x
    exponent = SIGNIFICANT_DIGITS - 1 - math.floor(math.log10(magnitude))
    exponent_back = -exponent
    high = magnitude
    low = 0.0
    for is_rounded in (False, True):
        while exponent != 0:  # multiply high + low by ten to the exponent, in steps that are exact powers
            step = min(abs(exponent), _LARGEST_POWER)
            factor = _POWERS_OF_TEN[step]
            term = high if exponent > 0 else high / factor
            product = term * factor
            term_high = _SPLITTER * term - (_SPLITTER * term - term)
            factor_high = _SPLITTER * factor - (_SPLITTER * factor - factor)
            term_low = term - term_high
            factor_low = factor - factor_high
            error = term_low * factor_low - (
                ((product - term_high * factor_high) - term_low * factor_high) - term_high * factor_low
            )
            if exponent > 0:
                error += low * factor
                high = product + error
                low = error - (high - product)
                exponent -= step
            else:
                error = (((high - product) - error) + low) / factor
                high = term + error
                low = error - (high - term)
                exponent += step
        if not is_rounded:
            digits = float(math.floor(high))
            rest = high - digits
            is_odd = digits - 2.0 * math.floor(digits * 0.5) == 1.0
            if rest > 0.5 or (rest == 0.5 and (low > 0.0 or (low == 0.0 and is_odd))):
                digits += 1.0
            high = digits
            low = 0.0
            exponent = exponent_back
    return high if x > 0.0 else -high
