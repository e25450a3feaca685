"""What a cycle of the loop costs: ``python -m tools.bench.loop``, seven minutes; ``--quick``, less than one.

Ratios to the least that Python can do, a *bare loop* of sleep, send and receive with the same bytes on the
same grid. What is compared takes turns within one run, so that a busy machine hits all alike; durations of
all turns are pooled, processor times are medians over the turns. The exit code is 1 where cycles run and
periods missed are not the length of the grid, and 0 otherwise: everything else is for a person to judge.
"""

import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from statistics import median
from typing import Annotated

from cyclopts import App, Parameter

from emulator.process import Emulator
from hm_driver.realtime.canary import Canary, CanaryOptions
from hm_driver.realtime.grid import period_ns_of
from hm_driver.realtime.options import LoopOptions, TimingOptions
from hm_driver.realtime.process import LoopProcess
from hm_driver.realtime.segment import Word
from hm_driver.realtime.shared import SharedBlock
from hm_driver.realtime.trace import Trace, TracePoint, excess_ns, trace_size
from hm_driver.recording.ring import Ring, ring_bytes
from tools.bench.loop_requests import TICK_S, Conversation, Mode, Wire
from tools.bench.loop_turns import PATIENT, BareOptions, Turn, pool, read_turn, run_child
from tools.cli.console import tell, write, write_json

RATE_HZ, FAST_HZ = 1000.0, 2500.0
SPIN_DUTY = 0.15
"""The loop's own default."""
_RING_BYTES = 1 << 22
_END_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where everything runs."""

    url: str
    loop_cpu: int | None
    """CPU of the loops and the first canary, or None where threads cannot be pinned."""
    device_cpu: int | None
    """CPU of the emulator and the second canary."""


@dataclass(slots=True)
class Row:
    """The turns of one way to run a loop."""

    name: str
    turns: list[Turn] = field(default_factory=list)
    excess: list[int] = field(default_factory=list)
    """Lateness beyond the canary's [ns], where there was one."""

    def values(self) -> dict[str, float]:
        """The row of the table: times in [µs] a cycle."""
        response = pool(turn.response for turn in self.turns)
        lateness = pool(turn.lateness for turn in self.turns)
        values = {
            "cycles": float(sum(turn.cycles for turn in self.turns)),
            "missed": float(sum(turn.missed for turn in self.turns)),
            "exchanges": sum(turn.requests for turn in self.turns) / sum(turn.cycles for turn in self.turns),
            "cpu_us": median(turn.cpu_us for turn in self.turns),
            "spun_us": median(turn.spun_us for turn in self.turns),
        }
        for name, histogram in (("lateness", lateness), ("response", response)):
            for share in (0.5, 0.99, 0.999):
                values[f"{name}_p{share * 100:g}_us"] = histogram.percentile_ns(share) * 1e-3
        if self.excess:
            ordered = sorted(self.excess)
            for share in (0.5, 0.99, 0.999):
                values[f"excess_p{share * 100:g}_us"] = ordered[int(share * (len(ordered) - 1))] * 1e-3
        return values


@dataclass(frozen=True, slots=True, kw_only=True)
class Overruns:
    """Deadlines of a fast loop that were missed, and what the canaries missed."""

    length: int
    """Deadlines of the grid."""
    missed: int
    late: int
    """Cycles that ended behind the next deadline."""
    beyond: int
    """Of the missed and late ones those near which neither canary was late by half a period."""


@contextlib.contextmanager
def place() -> Iterator[Place]:
    """An emulator, on a CPU of its own where there are two."""
    cpus = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    loop_cpu, device_cpu = (cpus[-1], cpus[-2]) if len(cpus) > 1 else (None, None)
    with Emulator(init_seconds=0.1) as emulator:
        if device_cpu is not None and emulator.pid is not None:
            os.sched_setaffinity(emulator.pid, {device_cpu})
        yield Place(url=emulator.url, loop_cpu=loop_cpu, device_cpu=device_cpu)


def run_loop_turn(
    where: Place,
    mode: Mode,
    *,
    seconds: float,
    spin_duty: float = 0.0,
    rate_hz: float = RATE_HZ,
    is_recording: bool = False,
    canary_cpus: tuple[int | None, ...] = (),
) -> tuple[Turn, list[TracePoint], list[list[TracePoint]]]:
    """One turn of the driver's loop process; what it and its canaries traced."""
    period_ns = period_ns_of(rate_hz)
    length = round((seconds + _END_S) * rate_hz)
    with contextlib.ExitStack() as stack:
        ring = stack.enter_context(_ring()) if is_recording else None
        trace_block = stack.enter_context(SharedBlock.create(trace_size(length), tag="trace"))
        trace = Trace(trace_block.buffer)
        stack.callback(trace.close)
        options = LoopOptions(
            url=where.url,
            timing=TimingOptions(rate_hz=rate_hz, spin_duty=spin_duty, cpu=where.loop_cpu),
            watch=PATIENT,
            ring=ring[0] if ring else "",
            trace=str(trace_block.path) if canary_cpus else "",
        )
        loop = stack.enter_context(LoopProcess(options))
        loop.start()
        start_ns = int(loop.segment.words[Word.START_NS])
        canaries = [
            stack.enter_context(
                Canary(CanaryOptions(period_ns=period_ns, start_ns=start_ns, length=length, cpu=cpu))
            )
            for cpu in canary_cpus
        ]
        _drive(loop, mode, seconds, ring[1] if ring else None)
        loop.request_stop()
        loop.wait(_END_S)
        points = [canary.points() for canary in canaries]
        return read_turn(loop.segment, period_ns), trace.points(), points


def _drive(loop: LoopProcess, mode: Mode, seconds: float, ring: Ring | None) -> None:
    """Be the application: a set-point every 10 ms, and the log's reader."""
    state = loop.state()
    start = (state.measured_x, state.measured_y, state.measured_z)
    begin = time.monotonic()
    for tick in range(1, round(seconds / TICK_S) + 1):
        time.sleep(max(0.0, begin + tick * TICK_S - time.monotonic()))
        loop.publish(mode.set_point(tick * TICK_S, tick, start))
        if ring is not None:
            ring.drain()


@contextlib.contextmanager
def _ring() -> Iterator[tuple[str, Ring]]:
    with SharedBlock.create(ring_bytes(_RING_BYTES), tag="ring") as block:
        Ring.format(block.buffer)
        with Ring(block.buffer) as ring:
            yield str(block.path), ring


def measure_rows(where: Place, *, turns: int, seconds: float) -> dict[str, Row]:
    """Everything at 1 kHz, in turns."""
    cycles, period_ns = round(seconds * RATE_HZ), period_ns_of(RATE_HZ)
    lines = {mode: Conversation(mode, Wire.COMBINED, cycles=cycles).lines for mode in Mode}

    def bare(mode: Mode, spin_duty: float) -> Turn:
        options = BareOptions(
            url=where.url, lines=lines[mode], period_ns=period_ns, cycles=cycles, spin_duty=spin_duty
        )
        return run_child("bare_main", options, cpu=where.loop_cpu)

    def loop(mode: Mode, spin_duty: float) -> Turn:
        return run_loop_turn(where, mode, seconds=seconds, spin_duty=spin_duty)[0]

    def memory(*, is_recording: bool) -> Turn:
        with _ring() as (path, _):
            options = BareOptions(period_ns=period_ns, cycles=cycles, ring=path if is_recording else "")
            return run_child("memory_main", options, cpu=where.loop_cpu)

    ways: dict[str, Callable[[], Turn]] = {
        "memory": partial(memory, is_recording=False),
        "memory, recorded": partial(memory, is_recording=True),
    }
    for mode in Mode:
        for spin_duty, name in ((0.0, mode.value), (SPIN_DUTY, f"{mode.value}, spin")):
            ways[f"bare {name}"] = partial(bare, mode, spin_duty)
            ways[f"loop {name}"] = partial(loop, mode, spin_duty)
    rows = {name: Row(name) for name in ways}
    for turn in range(turns):
        tell(f"turn {turn + 1} of {turns}")
        for name, way in ways.items():
            rows[name].turns.append(way())
    return rows


def measure_recording(where: Place, *, turns: int, seconds: float) -> dict[str, Row]:
    """The loop beside a canary on its CPU, with and without recording, in turns."""
    rows = {name: Row(name) for name in ("not recorded", "recorded")}
    for turn in range(2 * turns):
        row = rows["recorded" if turn % 2 else "not recorded"]
        result, points, canaries = run_loop_turn(
            where, Mode.POSITION, seconds=seconds, spin_duty=SPIN_DUTY,
            is_recording=bool(turn % 2), canary_cpus=(where.loop_cpu,),
        )  # fmt: skip
        row.turns.append(result)
        row.excess += excess_ns(points, canaries[0])
    return rows


def measure_fast(where: Place, *, turns: int, seconds: float) -> tuple[Row, Overruns]:
    """The loop at 2500 Hz, with a canary on each CPU."""
    row, overruns = Row("2500 Hz"), []
    for _ in range(turns):
        turn, points, canaries = run_loop_turn(
            where, Mode.ADMITTANCE, seconds=seconds, spin_duty=SPIN_DUTY, rate_hz=FAST_HZ,
            canary_cpus=(where.loop_cpu, where.device_cpu),
        )  # fmt: skip
        row.turns.append(turn)
        row.excess += excess_ns(points, canaries[0])
        overruns.append(count_overruns(points, canaries, period_ns=period_ns_of(FAST_HZ)))
    return row, Overruns(
        length=sum(one.length for one in overruns),
        missed=sum(one.missed for one in overruns),
        late=sum(one.late for one in overruns),
        beyond=sum(one.beyond for one in overruns),
    )


def count_overruns(points: list[TracePoint], canaries: list[list[TracePoint]], *, period_ns: int) -> Overruns:
    """Judge a loop's deadlines by what happened to the canaries, where all of them ran.

    Args:
        points: The loop's.
        canaries: Those of each canary.
        period_ns: Distance between deadlines [ns].
    """
    first = max(trace[0].number for trace in [points, *canaries])
    last = min(trace[-1].number for trace in [points, *canaries])
    stalled: set[int] = set()
    for trace in canaries:
        on_time = {point.number for point in trace if point.lateness_ns < period_ns // 2}
        for number in range(first, last + 1):
            if number not in on_time:
                stalled.update(range(number - 1, number + 3))
    responses = {point.number: point.response_ns for point in points}
    missed = {number for number in range(first, last + 1) if number not in responses}
    late = {number for number, response in responses.items() if response > period_ns} & {
        *range(first, last + 1)
    }
    return Overruns(
        length=last + 1 - first,
        missed=len(missed),
        late=len(late - missed),
        beyond=len((missed | late) - stalled),
    )


def ratios(rows: dict[str, Row]) -> dict[str, float]:
    """The loop over the bare loop, and what the other rows say."""
    values = {name: row.values() for name, row in rows.items()}
    result: dict[str, float] = {}
    for name in [name.removeprefix("bare ") for name in rows if name.startswith("bare ")]:
        loop, bare = values[f"loop {name}"], values[f"bare {name}"]
        for key in ("cpu_us", "response_p50_us", "response_p99_us", "response_p99.9_us"):
            result[f"{name}: {key.removesuffix('_us')}"] = loop[key] / max(1e-9, bare[key])
    result["logging_us"] = values["memory, recorded"]["cpu_us"] - values["memory"]["cpu_us"]
    return result


_COLUMNS = (
    ("cpu_us", "CPU"), ("spun_us", "spun"), ("exchanges", "exch."), ("lateness_p50_us", "late p50"),
    ("lateness_p99_us", "p99"), ("response_p50_us", "resp. p50"), ("response_p99_us", "p99"),
    ("response_p99.9_us", "p99.9"), ("missed", "missed"),
)  # fmt: skip


def table(rows: dict[str, Row]) -> list[str]:
    """The numbers, a line for each way."""
    lines = [f"{'[us] a cycle':<24}" + "".join(f"{title:>10}" for _, title in _COLUMNS)]
    for name, row in rows.items():
        values = row.values()
        cells = [f"{values[key]:.2f}" if key == "exchanges" else f"{values[key]:.1f}" for key, _ in _COLUMNS]
        lines.append(f"{name:<24}" + "".join(f"{cell:>10}" for cell in cells))
    return lines


app = App(name="loop", help="Measure what a cycle of the loop costs.")


@app.default
def main(
    *,
    turns: int = 10,
    seconds: float = 2.0,
    quick: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Measure and print.

    Args:
        turns: How often everything takes its turn.
        seconds: How long a turn lasts [s].
        quick: Two turns of half a second.
        json: Print one JSON object instead of the tables.
    """
    if quick:
        turns, seconds = 2, 0.5
    with place() as where:
        rows = measure_rows(where, turns=turns, seconds=seconds)
        recording = measure_recording(where, turns=turns, seconds=seconds)
        fast, overruns = measure_fast(where, turns=turns, seconds=seconds)
    exchanges = {
        f"{wire.value}, {mode.value}": Conversation(mode, wire, cycles=1000).exchanges
        for wire in Wire
        for mode in Mode
    }
    everything = {**rows, **recording, fast.name: fast}
    adds_up = all(turn.adds_up for row in everything.values() for turn in row.turns)
    if json:
        write_json({
            "turns": turns,
            "seconds": seconds,
            "rows": {name: row.values() for name, row in everything.items()},
            "ratios": ratios(rows),
            "exchanges": exchanges,
            "overruns": {name: getattr(overruns, name) for name in ("length", "missed", "late", "beyond")},
            "adds_up": adds_up,
        })  # fmt: skip
        return 0 if adds_up else 1
    for line in table(everything):
        write(line)
    write("")
    write("over the bare loop      CPU   response p50    p99  p99.9")
    quotients = ratios(rows)
    for name in [name.removeprefix("bare ") for name in rows if name.startswith("bare ")]:
        cells = [
            quotients[f"{name}: {key}"] for key in ("cpu", "response_p50", "response_p99", "response_p99.9")
        ]
        write(f"{name:<22}{cells[0]:5.2f}{cells[1]:15.2f}{cells[2]:7.2f}{cells[3]:7.2f}")
    write("")
    write(f"logging adds {quotients['logging_us']:.1f} us of processor time a cycle")
    before, behind = recording["not recorded"].values(), recording["recorded"].values()
    for key in ("excess_p50_us", "excess_p99_us", "excess_p99.9_us"):
        name = key.removesuffix("_us")
        write(f"{name:<14} without recording {before[key]:6.1f} us, with {behind[key]:6.1f} us")
    share = 100.0 * overruns.beyond / max(1, overruns.length)
    write(
        f"2500 Hz: {overruns.missed} missed and {overruns.late} late of {overruns.length} deadlines; "
        f"{overruns.beyond} ({share:.3f} %) where both canaries were on time"
    )
    for name, count in exchanges.items():
        write(f"exchanges a cycle, {name + ':':<30} {count:.2f}")
    if not adds_up:
        tell("cycles run and periods missed are not the length of the grid")
    return 0 if adds_up else 1


if __name__ == "__main__":
    sys.exit(app(result_action="return_value"))
