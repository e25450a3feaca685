"""What the loop says to the device in each mode and dialect, from a loop on a virtual clock."""

import math
from enum import Enum

from emulator.in_process import LockstepEmulator
from hm_driver.device.link import CommandLink
from hm_driver.protocol.framing import Dialect
from hm_driver.realtime import bring_up
from hm_driver.realtime.clock import VirtualClock
from hm_driver.realtime.core import LoopCore
from hm_driver.realtime.grid import Grid
from hm_driver.realtime.options import LoopOptions
from hm_driver.realtime.segment import Segment, Word
from hm_driver.realtime.setpoint import SetPoint
from hm_driver.transport.in_process import InProcessTransport
from tools.bench.loop_turns import PATIENT

TICK_S = 0.01
"""Time between two set-points [s]."""
_AMPLITUDE_M, _SWING_HZ = 0.01, 0.5


class Mode(Enum):
    """What the application asks for while the loop is measured."""

    ADMITTANCE = "admittance"
    """Every axis follows the hand."""
    POSITION = "position"
    """The springs of all three axes follow a reference that never rests."""

    def set_point(self, time_s: float, sequence: int, start: tuple[float, float, float]) -> SetPoint:
        """What the application asks for at this time, from this position on [m]."""
        if self is Mode.ADMITTANCE:
            return SetPoint(sequence=float(sequence))
        omega = 2.0 * math.pi * _SWING_HZ
        away, speed = math.sin(omega * time_s), omega * math.cos(omega * time_s)
        x, y, z = (place + _AMPLITUDE_M * away for place in start)
        return SetPoint(
            float(sequence), 0.0, 1.0, 1.0, 1.0, x, y, z, *[_AMPLITUDE_M * speed] * 3
        )  # fmt: skip


class Wire(Enum):
    """How the commands of a cycle are sent."""

    COMBINED = "text, combined"
    """All in one line."""
    SEPARATE = "text, one by one"
    FRAMED = "framed"
    """The framed dialect takes one command a request."""


class Conversation:
    """A loop with an emulator on a virtual clock, and the lines that it sends.

    Args:
        mode: What is asked for.
        wire: How it is sent.
        cycles: How long, in cycles.
        period_ns: Distance between deadlines [ns].
    """

    def __init__(self, mode: Mode, wire: Wire, *, cycles: int, period_ns: int = 1_000_000) -> None:
        emulator, clock, segment = LockstepEmulator(init_seconds=0.1), VirtualClock(), Segment.in_memory()
        clock.on_advance(emulator.advance_to_ns)
        transport = _Listener(emulator)
        link = CommandLink(transport, Dialect.FRAMED if wire is Wire.FRAMED else Dialect.TEXT)
        if wire is Wire.COMBINED:
            link.probe_combined()
        options = LoopOptions(url="sim://")
        bring_up.initialise(link, clock, timeout_s=10.0)
        bring_up.enter_session(link, options)
        core = LoopCore(
            link, Grid(clock, period_ns), clock, segment,
            parameters=options.parameters(), watch=PATIENT, keeps_timing=False,
        )  # fmt: skip
        transport.lines.clear()
        tick = max(1, round(TICK_S * 1e9 / period_ns))
        start: tuple[float, float, float] | None = None
        for cycle in range(cycles):
            core.run_cycle()
            if cycle % tick == 0:
                state = segment.state()
                start = start or (state.measured_x, state.measured_y, state.measured_z)
                segment.publish(mode.set_point(cycle * period_ns * 1e-9, cycle // tick + 1, start))
        self.lines = tuple(transport.lines)
        """Every request, in order."""
        self.exchanges = segment.words[Word.EXCHANGES] / cycles
        """Exchanges a cycle, the mean."""


class _Listener(InProcessTransport):
    """The way to the emulator, which keeps what was sent."""

    def __init__(self, emulator: LockstepEmulator) -> None:
        super().__init__(emulator)
        self.lines: list[bytes] = []

    def send(self, data: bytes) -> None:
        self.lines.append(data)
        super().send(data)
