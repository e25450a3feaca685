"""Numbers to and from the bytes of the wire, for kernels: the same text and the same doubles as Python's.

Text goes out as C's ``%g`` with six significant digits. It comes in exactly: a mantissa below 2**53 times or
by a power of ten up to 1e22 is rounded once (Clinger 1990); a short mantissa takes any power, because
`hm_driver.protocol.numbers.round_wire` finds the double next to a decimal of six digits. Everything else is
left to Python.
"""

import math
from types import FunctionType
from typing import Protocol

from emulator.compilation import subroutine
from hm_driver.protocol import numbers

SIGNIFICANT_DIGITS = numbers.SIGNIFICANT_DIGITS
LONGEST_NUMBER = 13
"""Characters of the longest text that `write_number` writes: ``-1.23457e-308``."""

_POWERS_OF_TEN = tuple(float(10**exponent) for exponent in range(23))
_LARGEST_POWER = 22
_LARGEST_EXPONENT = 250
_FIRST_WITH_DIGITS = 10 ** (SIGNIFICANT_DIGITS - 1)
_FIRST_BEYOND = 10**SIGNIFICANT_DIGITS
_LONGEST_MANTISSA = 15
_TIE = 1e-6
_SMALLEST_FIXED = -4
_ZERO, _NINE, _PLUS, _MINUS, _POINT, _EXPONENT = b"09+-.e"
_CAPITAL_EXPONENT = ord("E")
_BLANK = ord(" ")
_N, _A, _I, _F = b"naif"


class Text(Protocol):
    """Bytes that can be read and written: an array of uint8, or a bytearray for plain Python."""

    def __getitem__(self, index: int, /) -> int:
        """Read one byte."""
        ...

    def __setitem__(self, index: int, value: int, /) -> None:
        """Write one byte."""
        ...


round_wire = subroutine(FunctionType(numbers.round_wire.__code__, vars(numbers), "round_wire"))


@subroutine
def scale(x: float, exponent: int) -> float:
    """X times ten to the exponent; exact powers of ten, so that each of the few steps rounds once."""
    while exponent > 0:
        step = min(exponent, _LARGEST_POWER)
        x *= _POWERS_OF_TEN[step]
        exponent -= step
    while exponent < 0:
        step = min(-exponent, _LARGEST_POWER)
        x /= _POWERS_OF_TEN[step]
        exponent += step
    return x


@subroutine
def write_digits(text: Text, at: int, digits: int, count: int, whole: int) -> int:
    """Write ``count`` digits with a point behind the first ``whole``; returns where the text goes on."""
    has_point = 1 if whole < count else 0
    for place in range(count - 1, -1, -1):
        text[at + place + (has_point if place >= whole else 0)] = _ZERO + digits % 10
        digits //= 10
    if has_point:
        text[at + whole] = _POINT
    return at + count + has_point


@subroutine
def write_unusual(text: Text, at: int, x: float) -> int:
    """Write zero, an infinity or NaN, whose sign stands already."""
    if x == 0.0:
        text[at] = _ZERO
        return at + 1
    is_nan = x != x  # the shortest test for NaN
    text[at] = _N if is_nan else _I
    text[at + 1] = _A if is_nan else _N
    text[at + 2] = _N if is_nan else _F
    return at + 3


@subroutine
def write_number(text: Text, at: int, x: float) -> int:
    """Write a number as ``%g`` does, at most `LONGEST_NUMBER` bytes; returns where the text goes on."""
    if math.copysign(1.0, x) < 0.0 and x == x:  # NaN has no sign
        text[at] = _MINUS
        at += 1
    magnitude = abs(x)
    if magnitude == 0.0 or not magnitude <= 1.7976931348623157e308:
        return write_unusual(text, at, magnitude)
    exponent = math.floor(math.log10(magnitude))
    scaled = scale(magnitude, SIGNIFICANT_DIGITS - 1 - exponent)
    if scaled < _FIRST_WITH_DIGITS:  # the logarithm was rounded up
        exponent -= 1
        scaled = scale(magnitude, SIGNIFICANT_DIGITS - 1 - exponent)
    if abs(scaled - math.floor(scaled) - 0.5) < _TIE:
        scaled = scale(round_wire(magnitude), SIGNIFICANT_DIGITS - 1 - exponent)
    digits = math.floor(scaled + 0.5)
    if digits >= _FIRST_BEYOND:
        digits = digits // 10
        exponent += 1
    count = SIGNIFICANT_DIGITS
    while digits % 10 == 0:
        digits //= 10
        count -= 1
    if exponent < _SMALLEST_FIXED or exponent >= SIGNIFICANT_DIGITS:
        at = write_digits(text, at, digits, count, 1)
        text[at] = _EXPONENT
        text[at + 1] = _MINUS if exponent < 0 else _PLUS
        size = abs(exponent)
        width = 3 if size >= 100 else 2
        return write_digits(text, at + 2, size, width, width)
    while exponent < 0:  # 0.00012: as a number whose first digits are zeros
        count += 1
        exponent += 1
    while count <= exponent:  # 1200
        digits *= 10
        count += 1
    return write_digits(text, at, digits, count, exponent + 1)


@subroutine
def read_number(text: Text, at: int) -> tuple[float, int]:
    """Read a decimal number, blanks before it left out.

    Args:
        text: Where it stands; a byte that is no part of a number must come behind it.
        at: Where it begins.

    Returns:
        The double that Python's ``float`` makes of it, and where the text goes on; -1 for that where there
        is no number, or none that is read exactly here.
    """
    while text[at] == _BLANK:
        at += 1
    is_negative = text[at] == _MINUS
    if is_negative or text[at] == _PLUS:
        at += 1
    mantissa = 0
    significant = 0
    exponent = 0
    seen = 0
    behind_point = 0
    while True:
        byte = text[at]
        if _ZERO <= byte <= _NINE:
            mantissa = 10 * mantissa + (byte - _ZERO)
            if mantissa > 0:
                significant += 1
            exponent -= behind_point
            seen += 1
        elif byte == _POINT and behind_point == 0:
            behind_point = 1
        else:
            break
        if significant > _LONGEST_MANTISSA:
            return 0.0, -1
        at += 1
    if seen == 0:
        return 0.0, -1
    if text[at] == _EXPONENT or text[at] == _CAPITAL_EXPONENT:
        at += 1
        is_below = text[at] == _MINUS
        if is_below or text[at] == _PLUS:
            at += 1
        power = 0
        first = at
        while _ZERO <= text[at] <= _NINE and at < first + 4:
            power = 10 * power + (text[at] - _ZERO)
            at += 1
        if at == first or at == first + 4:
            return 0.0, -1
        exponent += -power if is_below else power
    value = float(mantissa)
    if mantissa != 0:
        if -_LARGEST_POWER <= exponent <= _LARGEST_POWER:
            value = scale(value, exponent)
        elif (
            significant <= SIGNIFICANT_DIGITS
            and 1 - _LARGEST_EXPONENT < exponent + significant < _LARGEST_EXPONENT
        ):
            value = round_wire(scale(value, exponent))
        else:
            return 0.0, -1
    return (-value if is_negative else value), at
