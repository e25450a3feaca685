"""Columns as the data frames of libraries that a user may have installed; neither is needed to read a log."""

from collections.abc import Callable
from importlib import import_module
from typing import Any

from hm_driver.errors import RecordingError
from hm_driver.recording.decoding import Columns

LIBRARIES = ("pandas", "polars")


def maker(library: str) -> Callable[[Columns], Any]:
    """The function that makes a data frame of columns.

    Raises:
        RecordingError: The library is not installed, or is none of `LIBRARIES`.
    """
    if library not in LIBRARIES:
        raise RecordingError(
            f"there are no frames of {library}; there are those of {' and '.join(LIBRARIES)}"
        )
    try:
        frame: Callable[[Columns], Any] = import_module(library).DataFrame
    except ImportError as error:
        raise RecordingError(
            f"{library} is not installed: pip install {library}, or take Recording.columns: numpy arrays"
        ) from error
    return frame if library == "pandas" else lambda columns: frame(_lists(columns))


def _lists(columns: Columns) -> dict[str, Any]:
    """Columns of objects as lists, of which polars finds the type by itself."""
    return {name: _list(values) if values.dtype == object else values for name, values in columns.items()}


def _list(values: Any) -> list[Any]:  # noqa: ANN401 - an array of any objects
    return [one.tolist() if hasattr(one, "tolist") else one for one in values]
