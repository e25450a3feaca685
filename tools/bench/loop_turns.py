"""One turn each of what the benchmark of the loop compares, every one in a process of its own.

The *bare loop* is the least that Python can do: sleep to a deadline, send, receive. The *memory loop* is the
driver's cycle with a device that answers from memory, so that there is no exchange.
"""

import socket
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hm_driver.device.link import connect_link
from hm_driver.realtime import bring_up
from hm_driver.realtime.child import receive_argument, spawn
from hm_driver.realtime.clock import WallClock
from hm_driver.realtime.core import LoopCore, folded_cycle
from hm_driver.realtime.grid import Grid, SpinMargin
from hm_driver.realtime.histogram import SIZE, Histogram
from hm_driver.realtime.measurements import STATE_QUESTION
from hm_driver.realtime.options import LoopOptions, TimingOptions, WatchOptions
from hm_driver.realtime.process import end_process
from hm_driver.realtime.publisher import Recording
from hm_driver.realtime.scheduling import enter_realtime, prepare_process
from hm_driver.realtime.segment import SEGMENT_SIZE, Segment, Status, Word
from hm_driver.realtime.shared import SharedBlock
from hm_driver.recording.ring import Ring
from hm_driver.transport.urls import DEFAULT_PORT, parse_device_url

PATIENT = WatchOptions(heartbeat_s=60.0, exchange_timeout_s=5.0, freeze_s=60.0, missed_s=0.0, stale_s=0.0)
"""On a machine that may stall, a loop that is measured only counts what it misses."""

_MARGIN_S = 30.0
_POLL_S = 0.005
_RECEIVED = 8192
_FIRST_PERIODS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class BareOptions:
    """One turn of the bare loop or of the memory loop."""

    url: str = ""
    """The device; empty for the memory loop."""
    lines: tuple[bytes, ...] = ()
    """Requests of the bare loop, one a cycle."""
    period_ns: int = 1_000_000
    """Distance between deadlines [ns]."""
    cycles: int = 1000
    """Cycles to run."""
    spin_duty: float = 0.0
    """Largest share of a core that may be spun; 0 never spins."""
    ring: str = ""
    """Path of the ring that the memory loop writes its records to; empty for none."""


class Turn(NamedTuple):
    """What one turn amounted to; of a turn that failed there is none."""

    cycles: int
    missed: int
    """Whole periods left out."""
    length: int
    """Deadlines from the first to the last, by the clock."""
    cpu_ns: int
    """Processor time of the loop's thread [ns], spinning included."""
    spun_ns: int
    elapsed_ns: int
    requests: int
    lateness: list[int]
    """Counts of the histograms' buckets."""
    response: list[int]

    @property
    def cpu_us(self) -> float:
        """Processor time of a cycle [µs], without what was spun."""
        return (self.cpu_ns - self.spun_ns) / max(1, self.cycles) * 1e-3

    @property
    def spun_us(self) -> float:
        """Time spun in a cycle [µs]."""
        return self.spun_ns / max(1, self.cycles) * 1e-3

    @property
    def adds_up(self) -> bool:
        """Whether cycles run and periods missed are the length of the grid."""
        return self.cycles + self.missed == self.length


class BareTimes(NamedTuple):
    """What the bare loop kept; times in [ns]."""

    lateness: list[int]
    response: list[int]
    missed: int
    length: int
    spun: int


def read_turn(segment: Segment, period_ns: int) -> Turn:
    """What a loop that has ended left in its segment; its length is that of the clock at the last cycle."""
    words = segment.words
    last_ns = int(segment.state().time_ns)
    return Turn(
        cycles=int(words[Word.CYCLES]),
        missed=int(words[Word.MISSED]),
        length=(last_ns - int(words[Word.START_NS])) // period_ns + 1,
        cpu_ns=int(words[Word.CPU_NS]),
        spun_ns=int(words[Word.SPUN_NS]),
        elapsed_ns=int(words[Word.ELAPSED_NS]),
        requests=int(words[Word.EXCHANGES]),
        lateness=segment.lateness.counts(),
        response=segment.response.counts(),
    )


def pool(counts: Iterable[Sequence[int]]) -> Histogram:
    """One histogram of several turns; its maximum is the upper end of the last bucket."""
    words = memoryview(bytearray(SIZE)).cast("q")
    for row in counts:
        for bucket, count in enumerate(row, start=1):
            words[bucket] += count
    words[0] = 1 << 62
    return Histogram(words)


def run_child(main: str, options: BareOptions, *, cpu: int | None) -> Turn:
    """Run the bare loop (``bare_main``) or the memory loop (``memory_main``) in a process of its own.

    Raises:
        SystemExit: The process failed; it said why on standard error.
    """
    with SharedBlock.create(SEGMENT_SIZE, tag="bench") as block:
        segment = Segment(block.buffer)
        process = spawn("tools.bench.loop_turns", main, (options, str(block.path), cpu))
        try:
            deadline = time.monotonic() + options.cycles * options.period_ns * 1e-9 + _MARGIN_S
            while process.poll() is None and time.monotonic() < deadline:
                time.sleep(_POLL_S)
        finally:
            end_process(process, patience_s=2.0)
        if segment.status is not Status.STOPPED:
            raise SystemExit(f"the process of {main} failed; it says why above")
        turn = read_turn(segment, options.period_ns)
        segment.close()
    return turn


def bare_main() -> None:
    """Bring the device up as the loop does, and run the bare loop on it."""
    options, path, cpu = _receive()
    link = connect_link(options.url)
    bring_up.initialise(link, WallClock(), timeout_s=_MARGIN_S)
    bring_up.enter_session(link, LoopOptions(url=options.url))
    target = parse_device_url(options.url)
    port = DEFAULT_PORT if target.port is None else target.port
    with SharedBlock.attach(path) as block, socket.create_connection((target.host, port)) as connection:
        segment = Segment(block.buffer)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        prepare_process()
        granted = enter_realtime(cpu=cpu)
        spin = SpinMargin(options.period_ns, duty_cap=options.spin_duty) if options.spin_duty else None
        started_ns, cpu_ns = time.monotonic_ns(), time.thread_time_ns()
        times = run_bare(connection.sendall, connection.recv, options.lines, options.period_ns, spin)
        words = segment.words
        words[Word.CPU_NS] = time.thread_time_ns() - cpu_ns
        words[Word.ELAPSED_NS] = time.monotonic_ns() - started_ns
        granted.release()
        words[Word.SPUN_NS], words[Word.MISSED] = times.spun, times.missed
        words[Word.CYCLES] = words[Word.EXCHANGES] = len(times.response)
        for lateness_ns, response_ns in zip(times.lateness, times.response, strict=True):
            segment.lateness.record(lateness_ns)
            segment.response.record(response_ns)
        segment.publish_state([0.0, (times.length - 1.0) * options.period_ns, *[0.0] * 21])
        segment.status = Status.STOPPED
        bring_up.make_safe(link)
        bring_up.clear(link)


def run_bare(
    send: Callable[[bytes], object],
    receive: Callable[[int], bytes],
    lines: Sequence[bytes],
    period_ns: int,
    spin: SpinMargin | None,
) -> BareTimes:
    """Sleep, send, receive, and keep two times: nothing else.

    Args:
        send: Sends a request.
        receive: Waits for a reply.
        lines: The requests, one a cycle.
        period_ns: Distance between deadlines [ns].
        spin: How long before a deadline the sleep ends; None for at the deadline.
    """
    now, sleep = time.monotonic_ns, time.sleep
    lateness, response = [0] * len(lines), [0] * len(lines)
    missed = spun = number = margin_ns = 0
    start_ns = now() + _FIRST_PERIODS * period_ns
    for cycle, line in enumerate(lines):
        due_ns = start_ns + number * period_ns
        if spin is not None:
            margin_ns = spin.margin_ns
        rest_ns = due_ns - margin_ns - now()
        if rest_ns > 0:
            sleep(rest_ns * 1e-9)
        wake_ns = now()
        if spin is not None:
            spin.observe(wake_ns - due_ns + margin_ns)
            if wake_ns < due_ns:
                spun += due_ns - wake_ns
                while (wake_ns := now()) < due_ns:
                    pass
        send(line)
        receive(_RECEIVED)
        response[cycle] = now() - due_ns
        lateness[cycle] = late_ns = wake_ns - due_ns
        skipped = late_ns // period_ns
        missed += skipped
        number += 1 + skipped
    return BareTimes(lateness, response, missed, number, spun)


class MemoryLink:
    """A device that answers from memory: the cycle's own cost is what is left."""

    combined = True

    def __init__(self) -> None:
        vectors = [f"[0.0101234,0.0201234,{i * 1e-5:g}];" for i in range(7)]
        tail = "[0.00123456,0.0234567,0.0345678];[1.23456,2.34567,3.45678];"
        self._acknowledged = [b"Spring's position set;" * count for count in range(40)]
        self._replies = [f"{vector}{tail}".encode() for vector in vectors]
        self._line = b""
        self._turn = 0

    def exchange(self, request: str) -> str:
        """Refuse what no cycle sends.

        Raises:
            NotImplementedError: Always.
        """
        raise NotImplementedError(request)

    def send_line(self, line: bytes) -> None:
        """As `CommandLink.send_line`."""
        self._line = line

    def receive_line(self) -> bytes:
        """As `CommandLink.receive_line`."""
        self._turn = turn = (self._turn + 1) % 7
        changes = self._line.count(b";") - 2
        if self._line.endswith(_STATE_END):
            return self._acknowledged[changes - 1] + self._replies[turn] + b"force;\n"
        return self._acknowledged[changes] + self._replies[turn] + b"\n"


def memory_main() -> None:
    """Run the driver's cycle without an exchange."""
    options, path, cpu = _receive()
    with SharedBlock.attach(path) as block:
        segment = Segment(block.buffer)
        recording = None
        if options.ring:
            ring_block = SharedBlock.attach(options.ring)
            recording = Recording(Ring(ring_block.buffer), 0)
        clock, step = WallClock(), folded_cycle()
        prepare_process()
        granted = enter_realtime(cpu=cpu)
        start_ns = clock.now_ns() + _FIRST_PERIODS * options.period_ns
        segment.words[Word.START_NS] = start_ns
        spin = SpinMargin(options.period_ns, duty_cap=options.spin_duty) if options.spin_duty else None
        grid = Grid(clock, options.period_ns, start_ns=start_ns, spin=spin)
        timing = TimingOptions(rate_hz=1e9 / options.period_ns)
        loop_options = LoopOptions(url="tcp://127.0.0.1", timing=timing)
        core = LoopCore(
            MemoryLink(), grid, clock, segment,
            parameters=loop_options.parameters(), watch=PATIENT, recording=recording,
            step=step,
        )  # fmt: skip
        started_ns, cpu_ns = clock.now_ns(), time.thread_time_ns()
        for _ in range(options.cycles):
            core.run_cycle()
        segment.words[Word.CPU_NS] = time.thread_time_ns() - cpu_ns
        segment.words[Word.ELAPSED_NS] = clock.now_ns() - started_ns
        segment.words[Word.SPUN_NS] = grid.spun_ns
        core.finish()
        granted.release()
        segment.status = Status.STOPPED


_STATE_END = f"{STATE_QUESTION}\n".encode()


def _receive() -> tuple[BareOptions, str, int | None]:
    argument = receive_argument()
    if not (isinstance(argument, tuple) and isinstance(argument[0], BareOptions)):
        raise SystemExit(2)
    return argument
