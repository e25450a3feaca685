"""Recording a session: ring in shared memory -> recorder process -> MCAP, and reading it back.

Example:
    >>> import hm_driver.recording
    >>> with hm_driver.recording.open("session.mcap") as log:  # doctest: +SKIP
    ...     force = log.columns("/device/state", 10.0, 20.0)["measured_force.z"]
"""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hm_driver.recording.reader import Recording


def open(path: str | Path) -> "Recording":  # noqa: A001 - read as hm_driver.recording.open
    """Open a log for reading.

    Raises:
        RecordingError: if it is missing, empty, or no MCAP file.
    """
    from hm_driver.recording.reader import Recording  # the loop process imports this package without numpy

    return Recording(path)
