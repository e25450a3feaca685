"""One scenario: the loop, its canaries and the loads, started, watched and ended."""

import contextlib
import math
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from emulator.process import Emulator
from hm_driver.errors import ConfigurationError, HapticMasterError
from hm_driver.realtime.canary import Canary, CanaryOptions
from hm_driver.realtime.grid import period_ns_of
from hm_driver.realtime.options import LoopOptions, TimingOptions, WatchOptions
from hm_driver.realtime.process import LoopHandle, LoopProcess, LoopThread
from hm_driver.realtime.result import LoopResult
from hm_driver.realtime.segment import Word
from hm_driver.realtime.setpoint import LoopState, SetPoint
from hm_driver.realtime.shared import SharedBlock
from hm_driver.realtime.trace import Trace, TracePoint, trace_size
from tools.jitter.faulty import SLEEPING_LAW, AlteredLoopProcess
from tools.jitter.loads import RecordingLoad, Signals, Tally, run_load
from tools.jitter.options import Fault, JitterOptions, Load, LoopKind, Scenario
from tools.jitter.pairing import Grid, Pairing
from tools.jitter.result import ScenarioResult
from tools.jitter.spread import Spread

TICK_S = 0.01
INTERRUPTED = "interrupted"
"""Problem of a scenario that the user ended."""
_SETTLE_S = 0.4
_COLLECT_S = 0.5
_MARGIN = 50
_ROWS_S = 40.0
_AMPLITUDE_M, _SWING_HZ = 0.005, 0.5
_PATIENT = WatchOptions(heartbeat_s=60.0, exchange_timeout_s=5.0, freeze_s=60.0, missed_s=0.0)
"""On a machine that may be shared and stall, a loop under test only counts what it misses."""

Rows = Callable[[list[TracePoint], list[TracePoint]], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cpus:
    """Where the loop and the emulator run; None where threads cannot be pinned."""

    loop: int | None
    device: int | None


def choose_cpus(asked: int | None) -> Cpus:
    """The loop on the CPU asked for or else the last one, the emulator on another if there is one.

    Raises:
        ConfigurationError: This process may not use that CPU.
    """
    if not hasattr(os, "sched_getaffinity"):
        return Cpus(loop=None, device=None)
    allowed = sorted(os.sched_getaffinity(0))
    if asked is not None and asked not in allowed:
        names = ", ".join(str(cpu) for cpu in allowed)
        raise ConfigurationError("--cpu", f"{asked} is none of the CPUs that this process may use: {names}")
    loop = allowed[-1] if asked is None else asked
    return Cpus(loop=loop, device=next((cpu for cpu in allowed if cpu != loop), loop))


@contextlib.contextmanager
def device_of(options: JitterOptions, cpus: Cpus) -> Iterator[str]:
    """Address of the device: the one asked for, or an emulator on a CPU of its own."""
    if options.device:
        yield options.device
        return
    with Emulator(init_seconds=0.1) as emulator:
        if cpus.device is not None and emulator.pid is not None:
            os.sched_setaffinity(emulator.pid, {cpus.device})
        yield emulator.url


def run_scenario(
    scenario: Scenario,
    options: JitterOptions,
    url: str,
    cpus: Cpus,
    *,
    has_canaries: bool = True,
    on_rows: Rows | None = None,
) -> ScenarioResult:
    """Run one scenario.

    Args:
        scenario: What runs beside the loop.
        options: Rate, duration, and what is done to the loop.
        url: The device.
        cpus: Where the loop and the emulator run.
        has_canaries: Whether canaries run; without them nothing delays the loop, and there is no excess.
        on_rows: Is handed the rows of the loop and of its canary, for an export.

    Raises:
        HapticMasterError: The loop did not start.
    """
    with contextlib.ExitStack() as stack:
        recording = None
        if Load.RECORDING in scenario.loads:
            recording = RecordingLoad(options.rate_hz)
            stack.callback(recording.close)
        rows = max(1000, round(_ROWS_S * options.rate_hz))
        block = stack.enter_context(SharedBlock.create(trace_size(rows), tag="trace"))
        trace = Trace(block.buffer)
        stack.callback(trace.close)
        loop_options = _loop_options(options, url, cpus, ring=recording, trace=str(block.path))
        loop = stack.enter_context(_make_loop(options, loop_options))
        loop.start()
        start_ns = int(loop.segment.words[Word.START_NS])
        period_ns = period_ns_of(options.rate_hz)
        canaries: list[Canary] = []
        for cpu in (cpus.loop, None if options.device else cpus.device):
            if has_canaries and not (canaries and cpu is None):
                canary = CanaryOptions(period_ns=period_ns, start_ns=start_ns, length=rows, cpu=cpu)
                canaries.append(stack.enter_context(Canary(canary)))
        app = _Application(loop, moves=not options.device)
        tallies, signals = [], Signals()
        with contextlib.ExitStack() as loads:
            for load in scenario.loads:
                tallies.append(tally := Tally(signals))
                if load is Load.RECORDING and recording is not None:
                    loads.enter_context(recording.running(tally))
                else:
                    loads.enter_context(run_load(load, tally))
            signals.go.set()
            app.run(_SETTLE_S)
            first = (time.monotonic_ns() - start_ns) // period_ns + 1
            grid = Grid(
                start_ns=start_ns,
                period_ns=period_ns,
                first=first,
                end=first + round(options.duration_s * options.rate_hz),
            )
            collector = _Collector(grid, trace, canaries, on_rows)
            try:
                problem = app.run(options.duration_s, each=collector.collect)
            except KeyboardInterrupt:  # what was measured of a long run is worth keeping
                problem = INTERRUPTED
            signals.done.set()
        time.sleep(3 * period_ns * 1e-9)
        collector.finish()
        return _result(scenario, options, loop, collector.pairing, canaries, app, tallies, problem)


class _Application:
    """The program beside the loop: a set-point each 10 ms, which moves the arm a little where it may."""

    def __init__(self, loop: LoopHandle, *, moves: bool) -> None:
        self._loop = loop
        self._moves = moves
        self._home = loop.state()
        self._ticks = 0
        self._last = time.monotonic()
        self.silence_s = 0.0
        """Longest time between two signs of life [s]."""
        self._is_counting = False
        self.heartbeats = 0

    def run(self, duration_s: float, *, each: Callable[[], None] | None = None) -> str:
        """Give signs of life for a while; why the loop ended before, or an empty text."""
        self._is_counting = each is not None
        end = due = time.monotonic()
        end += duration_s
        collect_at = due
        while (now := time.monotonic()) < end:
            self._beat(now)
            if each is not None and now >= collect_at:
                each()
                collect_at = now + _COLLECT_S
            try:
                self._loop.check()
            except HapticMasterError as error:
                return f"{type(error).__name__}: {error}"
            due = max(due + TICK_S, now)
            time.sleep(max(0.0, due - time.monotonic()))
        return ""

    def _beat(self, now: float) -> None:
        self._loop.publish(self._set_point())
        self._ticks += 1
        if self._is_counting:
            self.heartbeats += 1
            self.silence_s = max(self.silence_s, now - self._last)
        self._last = now

    def _set_point(self) -> SetPoint:
        sequence = float(self._ticks)
        if not self._moves:
            return SetPoint(sequence=sequence)
        home: LoopState = self._home
        phase = 2.0 * math.pi * _SWING_HZ * self._ticks * TICK_S
        return SetPoint(
            sequence=sequence,
            engage_z=1.0,
            target_z=home.measured_z + _AMPLITUDE_M * (1.0 - math.cos(phase)),
            velocity_z=2.0 * math.pi * _SWING_HZ * _AMPLITUDE_M * math.sin(phase),
        )


class _Collector:
    """Takes new rows out of the shared traces, and pairs those that are complete."""

    def __init__(self, grid: Grid, trace: Trace, canaries: list[Canary], on_rows: Rows | None) -> None:
        self._trace = trace
        self._canaries = canaries
        self._on_rows = on_rows
        self._seen = [grid.first] * (1 + len(canaries))
        self.pairing = Pairing(grid, canaries=len(canaries))

    def collect(self) -> None:
        newest = [self._trace.next_number, *(canary.next_number for canary in self._canaries)]
        self._take(min(newest) - _MARGIN)

    def finish(self) -> None:
        """Take what is there; of a loop that ended early, up to now."""
        grid = self.pairing.grid
        self._take(min(grid.end, (time.monotonic_ns() - grid.start_ns) // grid.period_ns))
        self.pairing.finish()

    def _take(self, upto: int) -> None:
        streams = [self._trace.since(self._seen[0])]
        streams += [canary.points(seen) for canary, seen in zip(self._canaries, self._seen[1:], strict=True)]
        for index, rows in enumerate(streams):
            if rows:
                self._seen[index] = rows[-1].number + 1
        if self._on_rows is not None:
            self._on_rows(streams[0], streams[1] if self._canaries else [])
        self.pairing.add(*streams, upto=upto)


def _make_loop(options: JitterOptions, loop_options: LoopOptions) -> LoopHandle:
    if options.loop is LoopKind.THREAD:
        return LoopThread(loop_options)
    if options.fault is Fault.RELATIVE or options.is_unprivileged:
        return AlteredLoopProcess(
            loop_options,
            has_relative_grid=options.fault is Fault.RELATIVE,
            is_unprivileged=options.is_unprivileged,
        )
    return LoopProcess(loop_options)


def _loop_options(
    options: JitterOptions, url: str, cpus: Cpus, *, ring: RecordingLoad | None, trace: str
) -> LoopOptions:
    timing = TimingOptions(rate_hz=options.rate_hz, spin_duty=options.spin_duty, cpu=cpus.loop)
    return LoopOptions(
        url=url,
        modes=options.modes,
        limits=options.motion,
        timing=timing,
        watch=WatchOptions() if options.is_robot else _PATIENT,
        ring="" if ring is None else ring.loop_ring,
        trace=trace,
        epoch_ns=time.time_ns() - time.monotonic_ns(),
        law=SLEEPING_LAW if options.fault is Fault.SLEEP else "",
    )


def _result(
    scenario: Scenario,
    options: JitterOptions,
    loop: LoopHandle,
    pairing: Pairing,
    canaries: list[Canary],
    app: _Application,
    tallies: list[Tally],
    problem: str,
) -> ScenarioResult:
    period_ns = pairing.grid.period_ns
    loop.request_stop()
    with contextlib.suppress(HapticMasterError):
        loop.wait(15.0)
    words = loop.segment.words
    last_wake_ns, start_ns = int(words[Word.LOOP_HEARTBEAT_NS]), int(words[Word.START_NS])
    loop.close()
    end: LoopResult = loop.result()
    grid = pairing.grid
    return ScenarioResult(
        name=scenario.name,
        rate_hz=options.rate_hz,
        duration_s=options.duration_s,
        cycles=end.cycles,
        missed=end.missed,
        grid_length=(last_wake_ns - start_ns) // period_ns + 1,
        window_cycles=pairing.cycles,
        window_missed=pairing.missed,
        own_missed=pairing.own_missed if canaries else None,
        canary_missed=pairing.canary_missed[0] if canaries else None,
        device_canary_missed=pairing.canary_missed[1] if len(canaries) > 1 else None,
        drift_us_per_s=pairing.drift.us_per_s,
        drift_resolution_us_per_s=pairing.drift.resolution_us_per_s,
        lateness=Spread.of(pairing.lateness),
        canary=Spread.of(pairing.canary_lateness),
        excess=Spread.of(pairing.excess),
        response=Spread.of(pairing.response),
        execution=Spread.of(pairing.execution),
        exchange=Spread.of(pairing.exchange),
        rung=str(end.rung),
        scheduling=end.scheduling,
        canary_rung=str(canaries[0].rung) if canaries else "",
        requests_per_cycle=end.requests_per_cycle,
        dialect=end.dialect,
        is_combined=end.is_combined,
        cpu_us_per_cycle=end.cpu_us_per_cycle,
        spun_share=end.spun_s / end.elapsed_s if end.elapsed_s else 0.0,
        heartbeats=app.heartbeats,
        longest_silence_ms=app.silence_s * 1e3,
        loads=tuple(tally.text for tally in tallies if tally.text),
        course=pairing.course,
        worst=pairing.worst,
        own_misses_s=tuple((number - grid.first) * period_ns * 1e-9 for number in pairing.own_misses),
        problem=problem,
    )
