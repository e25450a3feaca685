"""Compile a kernel, and get its plain-Python twin back.

A kernel is a scalar function of floats and flat arrays in plain Python. :func:`kernel` compiles it with
numba for other kernels, :func:`entry_point` for Python, and keeps the machine code on disk. numba looks
only at the file that holds a function when it decides whether stored code is still good, so an edit of a
function that is *called* would go unnoticed; the decorators therefore put a digest of the kernel, of all
kernels it calls and of the constants it reads into the name under which the code is stored.
"""

import hashlib
import sys
from collections.abc import Callable
from types import FunctionType, ModuleType
from typing import Any, Protocol, TypeVar, cast

from numba import njit
from numba.core.registry import CPUDispatcher

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "forceinline": True, "_nrt": False}
"""Kernels allocate nothing: inlining without counting references (``_nrt``) halves the cost of a step."""
_CALLED: dict[str, Any] = _OPTIONS | {"forceinline": False}
_INNER: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""What only other kernels call needs no way in from Python: a fifth of the compile time."""

F = TypeVar("F", bound=Callable[..., Any])


class Numbers(Protocol):
    """Flat array of floats; a list will do for plain Python."""

    def __getitem__(self, index: int, /) -> float: ...

    def __setitem__(self, index: int, value: float, /) -> None: ...


class Indices(Protocol):
    """Flat array of integers."""

    def __getitem__(self, index: int, /) -> int: ...


def kernel(function: F) -> F:
    """Compile a function for the kernels that call it."""
    _stamp(function)
    return cast("F", njit(**_OPTIONS, **_INNER)(function))


def part(function: F) -> F:
    """Make a function a part of the one kernel that calls it: it is compiled there, and not by itself."""
    _stamp(function)
    return cast("F", njit(inline="always", **_OPTIONS, **_INNER)(function))


def subroutine(function: F) -> F:
    """Compile a function that kernels call at many places: it is not copied into each of them."""
    _stamp(function)
    return cast("F", njit(**_CALLED, **_INNER)(function))


def entry_point(function: F) -> F:
    """Compile a function for Python, at its first call; what is stored counts while nothing changed."""
    _stamp(function)
    return cast("F", njit(cache=True, **_OPTIONS)(function))


def interpreted(compiled: Callable[..., Any]) -> Callable[..., Any]:
    """The plain-Python version of a kernel, in which all the kernels it calls are plain as well."""
    return _Interpreter().plain(compiled)


def _stamp(function: Callable[..., Any]) -> None:
    """Name a function by a digest of all that it depends on."""
    digest = hashlib.sha256()
    code = function.__code__
    digest.update(f"{sys.version_info[:2]}{code.co_code!r}{code.co_consts!r}{code.co_names!r}".encode())
    for name in code.co_names:
        digest.update(_describe(function.__globals__.get(name)).encode())
    function.__qualname__ = f"{function.__qualname__}_{digest.hexdigest()[:12]}"


def _describe(value: object) -> str:
    if isinstance(value, CPUDispatcher):
        return str(value.py_func.__qualname__)
    if isinstance(value, ModuleType) and value.__name__.split(".")[0] == __name__.split(".")[0]:
        return repr(sorted((k, v) for k, v in vars(value).items() if isinstance(v, (int, float))))
    return repr(value) if isinstance(value, (int, float, str, tuple)) else ""


class _Interpreter:
    """Rebuilds kernels on name spaces in which each kernel is replaced by its plain function."""

    def __init__(self) -> None:
        self._done: dict[int, Callable[..., Any]] = {}

    def plain(self, compiled: Callable[..., Any]) -> Callable[..., Any]:
        if id(compiled) not in self._done:
            source = cast("CPUDispatcher", compiled).py_func
            names = dict(source.__globals__)
            twin = FunctionType(source.__code__, names, source.__name__, source.__defaults__)
            self._done[id(compiled)] = twin
            for name in source.__code__.co_names:
                if isinstance(names.get(name), CPUDispatcher):
                    names[name] = self.plain(names[name])
        return self._done[id(compiled)]
