"""Columns as a Parquet file: exact types, and the unit of each column in its metadata."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hm_driver.errors import RecordingError
from hm_driver.recording.decoding import Columns
from tools.log.csv_file import as_json

if TYPE_CHECKING:
    from tools.log.export import Table

_ROWS = 1 << 16
"""Messages of a row group: more compress better, fewer take less memory."""


def write(path: Path, table: "Table", pieces: Iterator[Columns]) -> int:
    """Write a table; returns the number of its messages.

    Raises:
        RecordingError: pyarrow is not installed.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise RecordingError(
            'Parquet files need pyarrow: in the clone, .venv/bin/pip install ".[study]"; or take .csv or .mat'
        ) from error

    def field(name: str, kind: str) -> Any:  # noqa: ANN401 - pyarrow has no types
        unit = table.units.get(name)
        return pa.field(name, _type(pa, kind), metadata={"unit": unit} if unit else None)

    schema = pa.schema(
        [field(name, kind) for name, kind in table.kinds.items()], metadata={"topic": table.summary.topic}
    )
    rows = 0
    with pq.ParquetWriter(path, schema, compression="zstd") as writer:
        for columns in _gather(pieces):
            arrays = [
                pa.array(_values(columns[name], kind), type=schema.field(name).type)
                for name, kind in table.kinds.items()
            ]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            rows += len(arrays[0])
    return rows


def _type(pa: Any, kind: str) -> Any:  # noqa: ANN401 - pyarrow has no types
    if kind in ("message list", "bytes list", "text"):
        return pa.string()
    if kind == "bytes":
        return pa.binary()
    element = kind.removesuffix(" list")
    inner = pa.string() if element == "text" else pa.from_numpy_dtype(np.dtype(element))
    return pa.list_(inner) if element != kind else inner


def _values(values: Any, kind: str) -> Any:  # noqa: ANN401 - arrays and lists of anything
    return [as_json(one) for one in values] if kind in ("message list", "bytes list") else values


def _gather(pieces: Iterator[Columns]) -> Iterator[Columns]:
    """Pieces joined until they have enough messages for a row group."""
    held: list[Columns] = []
    rows = 0
    for piece in pieces:
        held.append(piece)
        rows += len(next(iter(piece.values())))
        if rows >= _ROWS:
            yield _join(held)
            held, rows = [], 0
    if held:
        yield _join(held)


def _join(pieces: list[Columns]) -> Columns:
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}
