"""The cycles as a trace that https://ui.perfetto.dev and chrome://tracing open.

The Trace Event Format: one JSON object with ``traceEvents``; times in [µs]. Each scenario is a process with
a thread for the loop and one for its canary. A cycle is a slice with the exchange in it; the wake-up is one
from the deadline on; lateness and excess are counters; missed deadlines are instants.
"""

import json
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from hm_driver.errors import ConfigurationError
from hm_driver.realtime.trace import TracePoint

CYCLES_KEPT = 30_000
"""Newest cycles of each scenario that go into the file."""
_LOOP, _CANARY = 1, 2

Event = dict[str, Any]
Rows = tuple[deque[TracePoint], deque[TracePoint]]


class TraceFile:
    """Keeps the newest cycles of each scenario, and writes them at the end.

    Args:
        path: JSON file to write.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._scenarios: list[tuple[str, Rows]] = []

    def begin(self, scenario: str) -> Callable[[list[TracePoint], list[TracePoint]], None]:
        """Begin a scenario; returns what takes its rows: the loop's and the canary's."""
        loop: deque[TracePoint] = deque(maxlen=CYCLES_KEPT)
        canary: deque[TracePoint] = deque(maxlen=CYCLES_KEPT)
        self._scenarios.append((scenario, (loop, canary)))

        def take(rows: list[TracePoint], beside: list[TracePoint]) -> None:
            loop.extend(rows)
            canary.extend(beside)

        return take

    def write(self) -> None:
        """Write the file.

        Raises:
            ConfigurationError: It cannot be written.
        """
        events = [event for number, one in enumerate(self._scenarios, 1) for event in _events(number, *one)]
        document = {"displayTimeUnit": "ns", "traceEvents": events}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.path.write_text(json.dumps(document), encoding="utf-8")
        except OSError as error:
            raise ConfigurationError("--trace", f"{self.path} cannot be written: {error.strerror}") from error


def _events(process: int, scenario: str, rows: Rows) -> Iterator[Event]:
    loop, canary = rows
    yield _name(process, 0, "process_name", f"scenario {scenario}")
    yield _name(process, _LOOP, "thread_name", "loop")
    yield _name(process, _CANARY, "thread_name", "canary")
    beside = {row.number: row for row in canary}
    before: TracePoint | None = None
    for row in loop:
        other = beside.get(row.number)
        yield from _cycle(process, row, other)
        if before is not None and row.number > before.number + 1:
            count = row.number - before.number - 1
            yield {
                "ph": "i", "s": "t", "pid": process, "tid": _LOOP, "ts": before.wake_ns * 1e-3,
                "name": f"missed {count}", "cat": "missed", "args": {"periods": count},
            }  # fmt: skip
        before = row
    for row in canary:
        yield _slice(process, _CANARY, "wake", row.wake_ns - row.lateness_ns, row.lateness_ns)


def _cycle(process: int, row: TracePoint, canary: TracePoint | None) -> Iterator[Event]:
    execution_ns = row.response_ns - row.lateness_ns
    deadline_ns = row.wake_ns - row.lateness_ns
    yield _slice(process, _LOOP, "wake", deadline_ns, row.lateness_ns)
    yield _slice(process, _LOOP, "cycle", row.wake_ns, execution_ns) | {"args": {"number": row.number}}
    yield _slice(process, _LOOP, "exchange", row.wake_ns, min(row.exchange_ns, execution_ns))
    values = {"loop": row.lateness_ns * 1e-3}
    yield _counter(process, "lateness [µs]", row.wake_ns, values)
    if canary is not None:
        yield _counter(process, "excess [µs]", row.wake_ns, {"loop": (row.wake_ns - canary.wake_ns) * 1e-3})


def _slice(process: int, thread: int, name: str, start_ns: int, duration_ns: int) -> Event:
    return {
        "ph": "X", "pid": process, "tid": thread, "ts": start_ns * 1e-3, "dur": duration_ns * 1e-3,
        "name": name, "cat": "loop" if thread == _LOOP else "canary",
    }  # fmt: skip


def _counter(process: int, name: str, time_ns: int, values: dict[str, float]) -> Event:
    return {"ph": "C", "pid": process, "ts": time_ns * 1e-3, "name": name, "args": values}


def _name(process: int, thread: int, kind: str, name: str) -> Event:
    return {"ph": "M", "pid": process, "tid": thread, "name": kind, "args": {"name": name}}
