"""Faults in one word, for a command line: ``KIND[=VALUE][@START][+DURATION]``.

>>> parse_fault_option("reply_delay=0.02@5+1")
Fault(kind='reply_delay', value=0.02, duration_s=1, at_s=5)
>>> parse_fault_option("force_bias=3,0,0").value
(3, 0, 0)
"""

import re

from emulator.faults import Fault, parse_fault
from hm_driver.errors import ConfigurationError

_FORM = re.compile(r"([^=@+]*)(?:=([^@]*?))?(?:@(.*?))?(?:(?<!\d[eE])(?<![=,@\[\s])\+(.*))?", re.DOTALL)
"""A plus sign that belongs to a number, as in 1e+2 or =+3, begins no duration."""


def parse_fault_option(text: str) -> Fault:
    """Read a fault.

    Args:
        text: Kind; after ``=`` its value, a vector with commas; after ``@`` the device time at
            which it begins [s], 0 if left out; after ``+`` how long it lasts [s], without end if left out.

    Raises:
        ConfigurationError: Not of this form, unknown kind, or a value or a time out of range.
    """
    form = _FORM.fullmatch(text)
    if form is None or not form[1]:
        problem = "must be KIND[=VALUE][@START][+DURATION], as in reply_delay=0.02@5+1"
        raise ConfigurationError("fault", problem, source=_source(text))
    kind, value, start, duration = form.groups()
    entry: dict[str, object] = {"kind": kind.strip()}
    if value is not None:
        entry["value"] = _parse_value(value)
    if start is not None:
        entry["at_s"] = _parse_number(start)
    if duration is not None:
        entry["duration_s"] = _parse_number(duration)
    try:
        return parse_fault(entry, is_scheduled=True)
    except ConfigurationError as error:
        raise ConfigurationError(error.field, error.problem, source=_source(text)) from error


def _parse_value(text: str) -> object:
    inner = text.strip().removeprefix("[").removesuffix("]")
    numbers = [_parse_number(word) for word in inner.split(",")]
    return numbers[0] if len(numbers) == 1 else numbers


def _parse_number(text: str) -> object:
    """The number, or the text where it is none, for the check to name."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _source(text: str) -> str:
    return f"--fault {text:.60}"
