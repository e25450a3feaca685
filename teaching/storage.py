"""Files of learners: numpy's npz without pickled objects, the parameters as JSON."""

import json
import os
import tempfile
import zipfile
import zlib
from pathlib import Path
from typing import Any, Final

import numpy as np

from hm_driver.errors import ConfigurationError
from teaching.kernels import FloatArray

FORMAT: Final = 2
"""Version of the files that :func:`write` writes."""


def write(path: str | Path, kind: str, parameters: dict[str, Any], arrays: dict[str, FloatArray]) -> None:
    """Write a learner aside, then move it into place.

    Raises:
        OSError: The file cannot be written.
    """
    target = Path(path)
    said = {
        name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in parameters.items()
    }
    contents: dict[str, Any] = {"format": FORMAT, "kind": kind, "parameters": json.dumps(said), **arrays}
    handle, aside = tempfile.mkstemp(prefix=target.name, suffix=".part", dir=target.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **contents)
        Path(aside).replace(target)
    except BaseException:
        Path(aside).unlink(missing_ok=True)
        raise


def read(path: str | Path, kind: str) -> tuple[dict[str, Any], dict[str, FloatArray]]:
    """Parameters and arrays of a learner of a kind.

    Raises:
        ConfigurationError: The file is no learner of this kind, damaged, or of another format.
        OSError: The file cannot be read.
    """
    try:
        with Path(path).open("rb") as file:
            contents = np.load(file, allow_pickle=False)
            if isinstance(contents, np.ndarray):
                raise damaged(path, "it is a single array")
            with contents:
                stored = {name: contents[name] for name in contents.files}
    except (ValueError, EOFError, KeyError, NotImplementedError, zipfile.BadZipFile, zlib.error) as error:
        raise damaged(path, f"{error}") from error
    try:
        found, name = int(stored.pop("format")), str(stored.pop("kind"))
    except (KeyError, TypeError, ValueError) as error:
        raise damaged(path, "it does not say its format") from error
    if found != FORMAT:
        advice = "update this software" if found > FORMAT else "learn it anew"
        raise ConfigurationError(
            "format",
            f"{found} of the file is not {FORMAT}, which this version reads; {advice}",
            source=str(path),
        )
    if name != kind:
        raise ConfigurationError("kind", f"the file holds a learner {name}, not {kind}", source=str(path))
    try:
        parameters = json.loads(str(stored.pop("parameters")))
    except (KeyError, json.JSONDecodeError) as error:
        raise damaged(path, "its parameters cannot be read") from error
    missing = {"state", "table", "blocks"} - stored.keys()
    if missing or not isinstance(parameters, dict) or any(a.dtype != np.float64 for a in stored.values()):
        raise damaged(path, "it is not what save() wrote")
    return parameters, stored


def damaged(path: str | Path, problem: str) -> ConfigurationError:
    """The error of a file that cannot be used."""
    return ConfigurationError(
        "learner", f"is no file that save() wrote, or damaged: {problem}", source=str(path)
    )
