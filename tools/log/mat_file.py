"""Columns as a MATLAB file of version 5: each topic a struct, each column a field of it.

The format asks for a column as a whole: columns go to temporary files first and come back one by one.
"""

import re
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hm_driver.errors import RecordingError
from hm_driver.recording.decoding import Columns
from tools.log.csv_file import as_json

if TYPE_CHECKING:
    from tools.log.export import Table

_LONGEST = 63
"""Characters of a name in MATLAB."""
_KEYWORDS = frozenset(
    (
        *("break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for", "function"),
        *("global", "if", "otherwise", "parfor", "persistent", "return", "spmd", "switch", "try", "while"),
    )
)
"""Words that are no names there."""


def write(path: Path, streams: Iterable[tuple["Table", Iterator[Columns]]]) -> int:
    """Write tables; returns the number of their messages.

    Raises:
        RecordingError: A topic is too large for the format.
    """
    from scipy.io import savemat
    from scipy.io.matlab import MatWriteError

    with tempfile.TemporaryDirectory(prefix=".export-", dir=path.parent) as directory:
        structs: dict[str, dict[str, Any]] = {}
        units: dict[str, dict[str, str]] = {}
        rows = 0
        for number, (table, pieces) in enumerate(streams):
            name = matlab_name(table.summary.topic, structs)
            columns = [
                _Column(Path(directory) / f"{number}-{place}", kind)
                for place, kind in enumerate(table.kinds.values())
            ]
            rows += _spool(columns, pieces)
            fields: dict[str, Any] = {}
            for column, values in zip(table.columns, columns, strict=True):
                fields[matlab_name(column, fields)] = values
            structs[name] = fields
            by_field = dict(zip(fields, table.columns, strict=True))
            units[name] = {field: table.units.get(column, "") for field, column in by_field.items()}
        try:
            savemat(
                str(path),
                structs | {matlab_name("units", structs): units},
                appendmat=False,
                long_field_names=True,
                oned_as="column",
            )
        except MatWriteError as error:
            raise RecordingError(
                f"a topic is too large for a MATLAB file ({error}); take less by --topic, --column, "
                "--start and --end, or export to .parquet, which MATLAB reads by parquetread"
            ) from error
    return rows


def matlab_name(name: str, taken: Iterable[str]) -> str:
    """A name that MATLAB takes, none of those taken: ``/device/state`` becomes ``device_state``."""
    clean = re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_")
    if not clean or not clean[0].isalpha() or clean in _KEYWORDS:
        clean = f"x_{clean}"
    clean, number, taken = clean[:_LONGEST], 1, set(taken)
    unique = clean
    while unique in taken:
        number += 1
        unique = f"{clean[: _LONGEST - 1 - len(str(number))]}_{number}"
    return unique


class _Column:
    """A column that waits in a file until the format asks for it; objects stay in memory, they are few."""

    def __init__(self, path: Path, kind: str) -> None:
        self._path = path
        self._kind = kind
        self._objects: list[Any] = []
        self._dtype = None if _is_object(kind) else np.dtype(kind)

    def open(self) -> IO[bytes] | None:
        return None if self._dtype is None else self._path.open("wb")

    def add(self, file: IO[bytes] | None, values: NDArray[Any]) -> None:
        if file is None:
            self._objects += values.tolist()
        else:
            file.write(np.ascontiguousarray(values, dtype=self._dtype).data)

    def __array__(self, dtype: object = None, copy: object = None) -> NDArray[Any]:
        del dtype, copy
        if self._dtype is not None:
            return np.fromfile(self._path, dtype=self._dtype)
        cells = np.empty(len(self._objects), dtype=object)
        for place, value in enumerate(self._objects):
            cells[place] = _cell(value, self._kind)
        return cells


def _is_object(kind: str) -> bool:
    return kind in ("text", "bytes") or kind.endswith(" list")


def _cell(value: Any, kind: str) -> Any:  # noqa: ANN401 - whatever a cell holds
    if kind == "bytes":
        return np.frombuffer(value, dtype=np.uint8)
    return as_json(value) if kind in ("message list", "bytes list") else value


def _spool(columns: list[_Column], pieces: Iterator[Columns]) -> int:
    files = [column.open() for column in columns]
    rows = 0
    try:
        for piece in pieces:
            for column, file, values in zip(columns, files, piece.values(), strict=True):
                column.add(file, values)
            rows += len(next(iter(piece.values())))
    finally:
        for file in files:
            if file is not None:
                file.close()
    return rows
