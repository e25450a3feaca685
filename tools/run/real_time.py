"""A session in real time: the loop in a process of its own, a device behind it, on the wall clock."""

import contextlib
import gc
import os
import time
from collections.abc import Iterator
from dataclasses import replace

from emulator.process import Emulator
from emulator.world import WorldClient
from hm_driver.errors import ConfigurationError
from hm_driver.realtime.canary import Canary, CanaryOptions
from hm_driver.realtime.clock import WallClock
from hm_driver.realtime.histogram import SIZE, Histogram
from hm_driver.realtime.options import LoopOptions
from hm_driver.realtime.process import LoopProcess
from hm_driver.realtime.scheduling import Rung, enter_realtime
from teaching import kernels
from teaching.hands.contract import Hand, PersonHand
from tools.run.demonstrator import build_demonstrator
from tools.run.hands import RemoteWorld
from tools.run.log import SessionLog
from tools.run.options import TICK_S, build_session
from tools.run.recording import open_recording
from tools.run.request import HandKind, Outcome, TeachRequest, TickTiming
from tools.run.runner import TICK_NS, Plugs, View, run_ticks

_PRIORITY = 60
_CANARY_PRIORITY = 61
_LONGEST_S = 3600
_TICK_PHASE_NS = 500_000
"""Ticks stand in the middle between two cycles of a loop at 1 kHz, so that they meet the newest state."""


_OWN_EMULATOR = {
    "missed_s": 0.0,
    "freeze_s": 2.0,
    "heartbeat_s": 2.0,
    "exchange_timeout_s": 2.0,
    "stale_s": 2.0,
}


class TickClock(WallClock):
    """The wall clock, with a record of how late the ticks woke up."""

    def __init__(self) -> None:
        self.lateness: dict[int, int] = {}
        """Deadline [ns] to lateness [ns]."""

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Sleep until the deadline [ns]."""
        super().sleep_until_ns(deadline_ns)
        self.lateness[deadline_ns] = self.now_ns() - deadline_ns


def run_real_time(request: TeachRequest, view: View, *, name: str) -> Outcome:
    """Run a session on the wall clock, and leave the device stopped whatever ends it.

    Raises:
        SafetyTrip: A limit tripped, and the arm was made safe; the log is complete up to there.
        DeviceFault: The device is in no state to go on.
        TransportError: The device or the world endpoint cannot be reached.
        RecordingError: The log cannot be written.
    """
    with contextlib.ExitStack() as stack:
        device, world_url = request.device, request.world
        shuffle, hand_rng, emulator_seed = request.streams()
        if device is None:
            emulator = stack.enter_context(Emulator(seed=emulator_seed))
            device, world_url = emulator.url, emulator.world_url
        world: RemoteWorld | None = None
        if request.hand is HandKind.SIMULATED:
            if world_url is None:
                raise ConfigurationError(
                    "--hand", "simulated needs --world, the second line that the emulator prints"
                )
            client = WorldClient(world_url)
            stack.callback(client.close)
            world = RemoteWorld(client)
        kernels.warm_up()
        session = build_session(request.options, request.task, shuffle)
        session.learner.warm_up()
        recording = stack.enter_context(
            open_recording(request, name=name, clock="wall", device=device, is_lockstep=False, tell=view.tell)
        )
        recording.wait_until_open()
        epoch_ns = time.time_ns() - time.monotonic_ns()
        log = SessionLog(recording.ring, reference_force=request.task.reference_force)
        loop = LoopProcess(_loop_options(request, device, str(recording.loop_ring), epoch_ns))
        clock = TickClock()
        try:
            with loop:
                loop.start()
                state = loop.state()
                hand: Hand = PersonHand()
                if world is not None:
                    hand = build_demonstrator(
                        request.task,
                        request.options.demonstrator,
                        hand_rng,
                        handle=(state.measured_x, state.measured_y, state.measured_z),
                    )
                grid_ns = _first_tick(loop)
                cpu = _canary_cpu()
                canary = stack.enter_context(
                    Canary(
                        CanaryOptions(
                            period_ns=TICK_NS,
                            start_ns=grid_ns,
                            length=round(_LONGEST_S / TICK_S),
                            priority=_CANARY_PRIORITY,
                            cpu=cpu,
                        )
                    )
                )
                plugs = Plugs(clock=clock, loop=loop, hand=hand, world=world, log=log, view=view)
                with _punctual(cpu):
                    start_ns = grid_ns + ((time.monotonic_ns() - grid_ns) // TICK_NS + 2) * TICK_NS
                    run_ticks(session, plugs, start_ns=start_ns, epoch_ns=epoch_ns)
                loop.request_stop()
                canary.close()
        finally:
            result = loop.result()
            log.event(time.monotonic_ns() + epoch_ns, "loop", result.scheduling)
            status = recording.finish()
        return Outcome(
            log=recording.path,
            lost=status.lost,
            loop=result.as_dict(),
            ticks=_tick_timing(clock, canary, grid_ns),
        )


def _loop_options(request: TeachRequest, device: str, ring: str, epoch_ns: int) -> LoopOptions:
    """Options of the loop.

    With an emulator of its own, on a machine that may be shared and stall, a session only counts its missed
    periods and is patient with silence. For a device that the user names the limits are those configured.
    """
    options = request.options
    return LoopOptions(
        url=device,
        modes=options.modes,
        limits=options.limits,
        geometry=options.geometry,
        timing=options.timing,
        watch=options.watch if request.device else replace(options.watch, **_OWN_EMULATOR),
        tick_s=TICK_S,
        init_timeout_s=options.init_timeout_s,
        ring=ring,
        epoch_ns=epoch_ns,
    )


def _first_tick(loop: LoopProcess) -> int:
    """Deadline of the first tick [ns]: soon, and in the middle between two cycles."""
    cycle_ns = int(loop.state().time_ns) or time.monotonic_ns()
    return cycle_ns + 20 * 1_000_000 + _TICK_PHASE_NS


@contextlib.contextmanager
def _punctual(cpu: int | None) -> Iterator[None]:
    """Climb the scheduling ladder with the calling thread and keep the garbage collector out of the ticks.

    The thread stays on the canary's CPU, as a host may stall one and not the other. Afterwards everything is
    as it was, so that a report is not built at a real-time priority.

    Args:
        cpu: The canary's CPU; None where threads cannot be pinned.
    """
    before = None if cpu is None else os.sched_getaffinity(0)
    granted = enter_realtime(_PRIORITY, cpu=cpu)
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()
        granted.release()
        if granted.rung is Rung.FIFO:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        elif granted.rung is Rung.NICE:
            os.setpriority(os.PRIO_PROCESS, 0, 0)
        if before is not None:
            os.sched_setaffinity(0, before)


def _canary_cpu() -> int | None:
    """The last CPU that this process may run on."""
    return max(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None


def _tick_timing(clock: TickClock, canary: Canary, start_ns: int) -> TickTiming:
    late = {(deadline - start_ns) // TICK_NS: value for deadline, value in clock.lateness.items()}
    histogram = Histogram(memoryview(bytearray(SIZE)).cast("q"))
    for value in late.values():
        histogram.record(value)
    floor = {point.number: point.lateness_ns for point in canary.points()}
    both = [late[number] - floor[number] for number in late.keys() & floor.keys()]
    return TickTiming(
        lateness=histogram.percentiles(),
        excess_max_us=max(both) / 1e3 if both else None,
        missed=max(late) - min(late) + 1 - len(late) if late else 0,
    )
