"""The loop's cycle, compiled: the functions of `hm_driver.realtime.cycle` as they stand, bit for bit."""

import types
from collections.abc import Callable
from typing import Any

from emulator.compilation import kernel
from hm_driver.realtime import cycle

_IN_ORDER = ("clamp", "follow", "step_spring", "step_assist", "check", "cycle")


def compile_cycle() -> Callable[..., int]:
    """The cycle on arrays of float64, for a kernel to call.

    Each function is compiled from the source of the driver's module with the compiled ones before it in its
    globals.
    """
    names: dict[str, Any] = dict(vars(cycle))
    for name in _IN_ORDER:
        plain = getattr(cycle, name)
        names[name] = kernel(types.FunctionType(plain.__code__, names, name, plain.__defaults__))
    compiled: Callable[..., int] = names["cycle"]
    return compiled
