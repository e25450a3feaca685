"""A control law of the user, run in the loop below nothing and above every limit.

A law is a class without constructor arguments and with ``step(state, command, dt)``: it gets the newest
`LoopState`, the application's `SetPoint` and the true dt [s], and returns the `SetPoint` that the modes and
limits then work on. It is asked in every cycle, so its targets are taken as they stand; those of an
application, which come less often, are interpolated. It is imported in the loop's process, so it has to live
without numpy and its like. Before the arm moves, an instance is tried with a state of zeros; the loop gets a
fresh one.

Example:
    >>> class Follow:
    ...     def step(self, state, command, dt):
    ...         return command._replace(engage_z=1.0, target_z=0.01)
"""

import importlib
import math
import sys
import threading
import time
from collections.abc import Sequence
from typing import Protocol

from hm_driver.errors import ConfigurationError
from hm_driver.realtime.cycle import U_SEQUENCE
from hm_driver.realtime.setpoint import LoopState, SetPoint

REFUSED_IMPORTS = ("numpy", "numba", "scipy", "matplotlib", "pandas", "torch")
"""Packages that would bring threads, locks and hundreds of megabytes into the loop's process."""
_DRY_RUNS = 200
_MOST_MODULES = 200
"""Modules that a law may bring with it; each is memory that is locked, and time at the start."""
_STALL_NS = 30_000_000
"""Half of the time after which the guardian takes the loop for frozen."""
_PATIENCE_S = 5.0


class ControlLaw(Protocol):
    """What a law has to offer."""

    def step(self, state: LoopState, command: SetPoint, dt: float) -> SetPoint:
        """Return the set-point for this cycle; never block, and never take longer than a part of a period."""
        ...


class LawRunner:
    """Calls a law and judges what it returns.

    Args:
        law: The law.
        name: How messages name it.
        budget_ns: Longest time a step may take [ns]; three longer ones in a row are a problem, and one
            alone that takes 30 ms more: short of that it may be a stall of the machine.
    """

    __slots__ = ("_budget_ns", "_law", "_name", "_slow", "_steps")

    def __init__(self, law: ControlLaw, *, name: str, budget_ns: int) -> None:
        self._law = law
        self._name = name
        self._budget_ns = budget_ns
        self._slow = 0
        self._steps = 0

    def step(self, state: LoopState, command: Sequence[float], dt: float) -> tuple[list[float], str]:
        """Run the law once; returns its set-point, and what is wrong with it or an empty text."""
        start_ns = time.monotonic_ns()
        try:
            values = [float(value) for value in self._law.step(state, SetPoint(*command), dt)]
        except Exception as error:  # noqa: BLE001  # whatever a user's law raises ends the session safely
            return [], f"the law {self._name} raised {type(error).__name__}: {error}"
        taken_ns = time.monotonic_ns() - start_ns
        if len(values) != len(SetPoint._fields) or not all(map(math.isfinite, values)):
            return [], f"the law {self._name} returned {values}, not a SetPoint of finite numbers"
        self._steps += 1
        values[U_SEQUENCE] = float(self._steps)
        self._slow = self._slow + 1 if taken_ns > self._budget_ns else 0
        if self._slow > 2 or taken_ns > self._budget_ns + _STALL_NS:
            limit_us = self._budget_ns * 1e-3
            return [], f"the law {self._name} took {taken_ns * 1e-3:.0f} µs; {limit_us:.0f} µs are allowed"
        return values, ""


def load_law(path: str, *, period_ns: int, patience_s: float = _PATIENCE_S) -> LawRunner:
    """Import a law and try it before the arm moves.

    Args:
        path: ``module:Class``.
        period_ns: Period of the loop [ns]; a step may take a third of it.
        patience_s: How long import and dry run may take together [s].

    Raises:
        ConfigurationError: It cannot be imported, imports what the loop refuses, fails its dry run, or does
            not return from it.
    """
    outcome: list[LawRunner | ConfigurationError] = []

    def load() -> None:
        try:
            outcome.append(_load(path, period_ns))
        except ConfigurationError as error:
            outcome.append(error)

    thread = threading.Thread(target=load, name="law", daemon=True)  # one that blocks is left behind
    thread.start()
    thread.join(patience_s)
    if not outcome:
        raise ConfigurationError(
            "law", f"{path} did not return from its import and dry run within {patience_s:g} s: it blocks"
        )
    if isinstance(outcome[0], ConfigurationError):
        raise outcome[0]
    return outcome[0]


def _load(path: str, period_ns: int) -> LawRunner:
    module_name, _, class_name = path.partition(":")
    if not (module_name and class_name):
        raise ConfigurationError("law", f"{path!r} is not module:Class")
    before = set(sys.modules)
    try:
        make = getattr(importlib.import_module(module_name), class_name)
        law = make()
    except (Exception, SystemExit) as error:  # whatever the module raises is the reason for the refusal
        raise ConfigurationError(
            "law", f"{path} cannot be loaded: {type(error).__name__}: {error}"
        ) from error
    heavy = sorted({name for name in REFUSED_IMPORTS if name in sys.modules and name not in before})
    if heavy:
        raise ConfigurationError(
            "law", f"{path} imports {', '.join(heavy)}: the loop's process has to do without"
        )
    brought = len(sys.modules) - len(before)
    if brought > _MOST_MODULES:
        raise ConfigurationError(
            "law", f"{path} brings {brought} modules with it, {_MOST_MODULES} are allowed: import less"
        )
    runner = LawRunner(law, name=path, budget_ns=period_ns // 3)
    for _ in range(_DRY_RUNS):
        _, problem = runner.step(LoopState(), SetPoint(), period_ns * 1e-9)
        if problem:
            raise ConfigurationError("law", f"dry run: {problem}")
    return LawRunner(make(), name=path, budget_ns=period_ns // 3)
