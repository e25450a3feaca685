"""One run of the loop from connecting to the stopped device; the same in a process and in a thread."""

import contextlib
import time
from contextlib import ExitStack

from hm_driver.device.link import CommandLink, connect_link
from hm_driver.errors import HapticMasterError, LoopError
from hm_driver.protocol.framing import Dialect
from hm_driver.realtime import bring_up
from hm_driver.realtime.claim import DeviceClaim
from hm_driver.realtime.clock import WallClock
from hm_driver.realtime.core import LoopCore, folded_cycle
from hm_driver.realtime.failure import encode_error
from hm_driver.realtime.grid import Grid, SpinMargin, period_ns_of
from hm_driver.realtime.law import load_law
from hm_driver.realtime.options import LoopOptions
from hm_driver.realtime.publisher import Recording
from hm_driver.realtime.scheduling import Granted, Rung, enter_realtime, prepare_process
from hm_driver.realtime.segment import GuardianStatus, Segment, Status, Word
from hm_driver.realtime.shared import SharedBlock
from hm_driver.realtime.trace import Trace
from hm_driver.recording.ring import Ring

_GUARDIAN_WAIT_S = 20.0


class StoppedEarlyError(LoopError):
    """The application asked for the end before the loop ran."""


def run_loop(options: LoopOptions, segment: Segment, *, owns_process: bool) -> None:
    """Bring the device up, run the loop, bring the device down; the outcome is left in the segment.

    Args:
        options: What to run.
        segment: Shared with the application and the guardian.
        owns_process: Whether the process holds nothing but the loop, so that its memory may be locked, its
            garbage collection switched off, and time spun away.
    """
    try:
        _Run(options, segment, owns_process=owns_process).run()
    except StoppedEarlyError:
        segment.status = Status.STOPPED
    except HapticMasterError as error:
        kind, text = encode_error(error)
        segment.write_text("kind", kind)
        segment.write_text("error", text)
        segment.status = Status.TRIPPED if segment.trip else Status.FAILED


class _Run:
    def __init__(self, options: LoopOptions, segment: Segment, *, owns_process: bool) -> None:
        self._options = options
        self._segment = segment
        self._owns_process = owns_process
        self._clock = WallClock()

    def run(self) -> None:
        options, segment = self._options, self._segment
        segment.status = Status.BRINGING_UP
        period_ns = period_ns_of(options.timing.rate_hz)
        law = load_law(options.law, period_ns=period_ns) if options.law else None
        step = folded_cycle()  # takes milliseconds, so before the grid
        with ExitStack() as stack:
            recording = self._open_recording(stack)
            trace = self._open_trace(stack)
            stack.enter_context(DeviceClaim(options.url))
            link = connect_link(options.url, timeout_s=options.connect_timeout_s)
            stack.callback(link.close)
            link.probe_combined()
            segment.words[Word.FRAMED] = link.dialect is Dialect.FRAMED
            segment.words[Word.COMBINED] = link.combined
            try:
                self._bring_up(link)
                link.timeout_s = options.watch.exchange_timeout_s
                granted = self._enter_realtime()
                stack.callback(granted.release)
                spins = self._owns_process and granted.may_spin
                spin = SpinMargin(period_ns, duty_cap=options.timing.spin_duty) if spins else None
                start_ns = self._clock.now_ns() + 2 * period_ns
                segment.words[Word.START_NS] = start_ns
                grid = Grid(self._clock, period_ns, start_ns=start_ns, spin=spin)
                core = LoopCore(
                    link,
                    grid,
                    self._clock,
                    segment,
                    parameters=options.parameters(),
                    watch=options.watch,
                    recording=recording,
                    trace=trace,
                    law=law,
                    session_state=options.state,
                    step=step,
                )
                self._cycle(core)
            except BaseException:
                with contextlib.suppress(HapticMasterError):  # what went wrong first is what is told
                    self._make_safe(link)
                raise
            if core.is_link_usable:
                self._make_safe(link)
                link.timeout_s = options.connect_timeout_s
                bring_up.clear(link)
        segment.status = Status.TRIPPED if segment.trip else Status.STOPPED

    def _open_recording(self, stack: ExitStack) -> Recording | None:
        if not self._options.ring:
            return None
        block = stack.enter_context(SharedBlock.attach(self._options.ring))
        ring = Ring(memoryview(block.buffer))
        stack.callback(ring.close)
        return Recording(ring, self._options.epoch_ns)

    def _open_trace(self, stack: ExitStack) -> Trace | None:
        if not self._options.trace:
            return None
        block = stack.enter_context(SharedBlock.attach(self._options.trace))
        trace = Trace(block.buffer)
        stack.callback(trace.close)
        return trace

    def _bring_up(self, link: CommandLink) -> None:
        options, segment = self._options, self._segment
        segment.words[Word.DEVICE_TOUCHED] = 1
        info = bring_up.initialise(
            link, self._clock, timeout_s=options.init_timeout_s, on_poll=self._raise_if_stopped
        )
        segment.write_text("device", info.describe())
        if options.has_guardian:
            self._await_guardian()
        bring_up.enter_session(link, options)

    def _raise_if_stopped(self) -> None:
        if self._segment.words[Word.STOP_REQUESTED]:
            raise StoppedEarlyError("the application asked for the end before the loop ran")

    def _await_guardian(self) -> None:
        deadline_ns = self._clock.now_ns() + int(_GUARDIAN_WAIT_S * 1e9)
        while (status := self._segment.guardian().status) is GuardianStatus.ABSENT:
            self._raise_if_stopped()
            if self._clock.now_ns() > deadline_ns:
                raise LoopError(f"the guardian did not start within {_GUARDIAN_WAIT_S:g} s")
            time.sleep(0.002)
        if status is not GuardianStatus.WATCHING:
            raise LoopError(f"there is no guardian: {self._segment.guardian().text}")

    def _enter_realtime(self) -> Granted:
        """Take the best rung; the memory is locked first, which takes milliseconds."""
        timing, segment = self._options.timing, self._segment
        if self._owns_process:
            prepared = prepare_process(lock_memory=timing.lock_memory)
            segment.words[Word.MEMORY_LOCKED] = prepared.memory_locked
        granted = enter_realtime(
            timing.priority,
            cpu=timing.cpu,
            best=Rung.FIFO if self._owns_process else Rung.SLACK,
            hold_dma_latency=self._owns_process,
            require_realtime=timing.require_realtime,
        )
        segment.words[Word.RUNG] = granted.rung.level
        segment.write_text("grant", granted.describe())
        return granted

    def _cycle(self, core: LoopCore) -> None:
        segment, grid = self._segment, core.grid
        segment.words[Word.LOOP_HEARTBEAT_NS] = self._clock.now_ns()
        segment.status = Status.RUNNING
        started_ns, cpu_ns = self._clock.now_ns(), time.thread_time_ns()
        run_cycle = core.run_cycle
        try:
            while run_cycle():
                pass
        finally:
            core.finish()
            segment.words[Word.CPU_NS] = time.thread_time_ns() - cpu_ns
            segment.words[Word.ELAPSED_NS] = self._clock.now_ns() - started_ns
            segment.words[Word.SPUN_NS] = grid.spun_ns

    def _make_safe(self, link: CommandLink) -> None:
        """Stop the device; once, whatever the way here was."""
        words = self._segment.words
        words[Word.STOPS_SENT] += 1
        bring_up.make_safe(link)
        words[Word.STOPPED_NS] = self._clock.now_ns()
