"""The results of a study on disk: Parquet parts that are only ever added to, and what they are results of."""

import contextlib
import json
import os
import secrets
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from hm_driver.errors import ConfigurationError
from hm_driver.version import __version__
from tools.study.plan import FORMAT, Case, Study

PARTS: Final = "parts"
DESCRIPTION: Final = "study.json"
FILE: Final = "study.toml"

_ERRORS = tuple(
    f"{kind}_{place}_{statistic}"
    for kind in ("grid", "run")
    for place in ("overall", "inside", "border")
    for statistic in ("mean", "p95", "max")
)
FIGURES: Final = (
    *("coverage", "session_s", "teaching_s", "autonomy_s", "human_share"),
    *("share_wrong", "auc_std", "auc_w_max"),
    *_ERRORS,
)
"""Columns of numbers; NaN where a session has none."""
COUNTS: Final = ("updates", "models", "models_added", "models_pruned", "samples", "hand_overs")
CURVES: Final = {"curve_s": pa.float64(), "curve_error": pa.float64(), "curve_models": pa.int64()}
SCHEMA: Final = pa.schema(
    [
        pa.field("key", pa.string()),
        pa.field("seed", pa.uint64()),
        pa.field("ended", pa.string()),
        *(pa.field(name, pa.int64()) for name in COUNTS),
        *(pa.field(name, pa.float64()) for name in FIGURES),
        *(pa.field(name, pa.list_(kind)) for name, kind in CURVES.items()),
    ],
    metadata={"format": str(FORMAT), "version": __version__},
)

Table = Mapping[str, NDArray[Any]]
"""Columns by name, all of shape (n,); a curve's cells are arrays."""


class Store:
    """The directory of a study's results.

    Args:
        directory: Is made if need be.

    Raises:
        ConfigurationError: It holds the results of another version, or something else.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._parts = directory / PARTS
        description = self._read_description()
        if description is None and directory.is_dir() and any(directory.iterdir()):
            raise ConfigurationError(
                "--output", "holds files that are no results of a study; choose another directory",
                source=str(directory),
            )  # fmt: skip

    def begin(self, study: Study) -> None:
        """Note what is going to be run; what is there already is kept.

        Raises:
            ConfigurationError: The directory cannot be written.
        """
        description = {
            "format": FORMAT,
            "version": __version__,
            "title": study.title,
            "cases": [
                {"part": case.part, "settings": dict(case.settings), "keys": [job.key for job in case.jobs]}
                for case in study.cases
            ],
        }
        try:
            self._parts.mkdir(parents=True, exist_ok=True)
            for leftover in self._parts.glob("*.tmp"):
                leftover.unlink()
            _replace(self.directory / FILE, study.text.encode())
            _replace(self.directory / DESCRIPTION, json.dumps(description, ensure_ascii=False).encode())
        except OSError as error:
            raise ConfigurationError(
                "--output", f"cannot be written: {error.strerror or error}", source=str(self.directory)
            ) from error

    def add(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Add the rows of sessions, all of them or, if killed meanwhile, none."""
        table = pa.Table.from_pylist(list(rows), schema=SCHEMA)
        name = f"{rows[0]['key']}-{secrets.token_hex(4)}"
        temporary = self._parts / f"{name}.tmp"
        pq.write_table(table, temporary, compression="zstd")
        temporary.replace(self._parts / f"{name}.parquet")

    def keys(self) -> set[str]:
        """Keys of the sessions that are there."""
        return {key for part in self._paths() for key in self._read(part, ["key"])["key"].to_pylist()}

    def table(self) -> Table:
        """All rows, each session once, in the order of their keys."""
        whole = pa.concat_tables([SCHEMA.empty_table(), *(self._read(part) for part in self._paths())])
        keys = np.array(whole["key"].to_pylist(), dtype=object)
        _, first = np.unique(keys.astype(str), return_index=True)
        return {name: whole[name].to_numpy(zero_copy_only=False)[first] for name in SCHEMA.names}

    def cases(self) -> tuple[str, list[Case], list[tuple[str, ...]]]:
        """Title of the study, its cases without their jobs, and the keys of each case's sessions.

        Raises:
            ConfigurationError: There are no results here.
        """
        description = self._read_description()
        if description is None:
            raise ConfigurationError(
                "directory", "holds no results of a study; hm study run FILE --output DIR makes some",
                source=str(self.directory),
            )  # fmt: skip
        cases = [
            Case(part=case["part"], settings=tuple(case["settings"].items()), jobs=())
            for case in description["cases"]
        ]
        return description["title"], cases, [tuple(case["keys"]) for case in description["cases"]]

    def _paths(self) -> Iterable[Path]:
        return sorted(self._parts.glob("*.parquet"))

    def _read(self, path: Path, columns: list[str] | None = None) -> pa.Table:
        try:
            table = pq.read_table(path, columns=columns)
        except (OSError, pa.ArrowException) as error:
            raise ConfigurationError(
                path.name,
                f"cannot be read: {error}; remove the file, and hm study run makes its sessions again",
                source=str(self._parts),
            ) from error
        return table

    def _read_description(self) -> dict[str, Any] | None:
        path = self.directory / DESCRIPTION
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        except OSError as error:
            raise ConfigurationError(DESCRIPTION, f"cannot be read: {error}", source=str(path)) from error
        try:
            description = json.loads(text)
            version = description["format"]
        except (ValueError, TypeError, KeyError) as error:
            raise ConfigurationError(
                DESCRIPTION, f"is damaged: {error!r}; run the study again into the same directory after "
                "removing this file, which keeps the sessions that are there", source=str(path)
            ) from error  # fmt: skip
        if version != FORMAT:
            raise ConfigurationError(
                "format",
                f"{version!r} is another version's; this one reads {FORMAT}: show the results with the "
                "version that made them, or run the study again into another directory",
                source=str(path),
            )
        return dict(description)


def _replace(path: Path, data: bytes) -> None:
    temporary = path.with_suffix(path.suffix + ".tmp")
    with temporary.open("wb") as file:
        file.write(data)
        file.flush()
        with contextlib.suppress(OSError):
            os.fsync(file.fileno())
    temporary.replace(path)
