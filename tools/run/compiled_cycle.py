"""The loop's cycle, compiled: the functions of `hm_driver.realtime.cycle` as they stand, bit for bit."""

import types
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

from hm_driver.realtime import cycle

_IN_ORDER = ("clamp", "follow", "step_spring", "step_assist", "check", "cycle")


def compile_cycle() -> Callable[..., int]:
    """The cycle on arrays of float64, for a kernel to call.

    Each function is compiled from the source of the driver's module with the compiled ones before it in its
    globals; numba keeps the result in its cache.
    """
    names: dict[str, Any] = dict(vars(cycle))
    for name in _IN_ORDER:
        plain = getattr(cycle, name)
        copy = types.FunctionType(plain.__code__, names, name, plain.__defaults__)
        copy.__module__ = cycle.__name__
        names[name] = njit(cache=True)(copy)
    compiled: Callable[..., int] = names["cycle"]
    return compiled


class CompiledCycle:
    """`cycle.cycle` on the lists of the loop's core, computed by the compiled one."""

    def __init__(self) -> None:
        self._cycle = compile_cycle()
        self._s = np.zeros(cycle.STATE_SIZE)
        self._p = np.zeros(cycle.PARAMETER_SIZE)
        self._u = np.zeros(cycle.SETPOINT_SIZE)
        self._m = np.zeros(cycle.MEASUREMENT_SIZE)
        self._last_p: list[float] = []
        self._cycle(self._s, self._p + 1.0, self._u, self._m, 0.001)
        self._s[:] = 0.0

    def __call__(self, s: list[float], p: list[float], u: list[float], m: list[float], dt: float, /) -> int:
        """As `cycle.cycle`; the state is one's own, so that one object serves one loop."""
        if p is not self._last_p:
            self._p[:] = p
            self._last_p = p
        self._u[:] = u
        self._m[:] = m
        trip = self._cycle(self._s, self._p, self._u, self._m, dt)
        s[:] = self._s.tolist()
        return trip
