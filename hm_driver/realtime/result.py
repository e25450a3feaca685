"""What a run of the loop amounted to, read from its segment."""

from dataclasses import asdict, dataclass

from hm_driver.realtime.histogram import Percentiles
from hm_driver.realtime.scheduling import Rung
from hm_driver.realtime.segment import GuardianReport, Segment, Status, Trip, Word


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopResult:
    """Statistics of a run; durations of percentiles in [µs]."""

    status: Status
    """How far it came."""
    trip: Trip
    """What tripped, or ``Trip.NONE``."""
    trip_detail: str
    """The value and the limit."""
    cycles: int
    """Cycles run."""
    missed: int
    """Periods missed; with the cycles the length of the grid."""
    grid_length: int
    """Deadlines that passed."""
    soft_overruns: int
    """Cycles that ended behind the soft budget."""
    requests: int
    """Requests sent to the device by the cycles."""
    dialect: str
    """``text`` or ``framed``."""
    is_combined: bool
    """Whether one request held all commands of a cycle."""
    rung: Rung
    """Rung of the scheduling ladder."""
    scheduling: str
    """The rung and what was refused, in words."""
    is_memory_locked: bool
    """Whether the loop's memory was locked."""
    device: str
    """What the device said of itself."""
    lateness: Percentiles
    """Wake-up behind the deadline."""
    execution: Percentiles
    """Wake-up to end of cycle."""
    exchange: Percentiles
    """Exchange with the device."""
    response: Percentiles
    """Deadline to end of cycle, exchange included."""
    elapsed_s: float
    """Time on the grid [s]; 0 until the loop has ended."""
    cpu_s: float
    """Processor time of the loop's thread [s], spinning included; 0 until the loop has ended."""
    spun_s: float
    """Time spun away for punctuality [s]; 0 until the loop has ended."""
    guardian: GuardianReport
    """What the guardian did."""
    stops_sent: int
    """Times that the loop sent the safe stop."""
    stop_latency_s: float
    """From the trip to the first acknowledged stop, the loop's or the guardian's [s]; 0 without one."""

    @property
    def requests_per_cycle(self) -> float:
        """Exchanges with the device in a cycle."""
        return self.requests / self.cycles if self.cycles else 0.0

    @property
    def cpu_us_per_cycle(self) -> float:
        """Processor time of a cycle [µs], without what was spun."""
        return (self.cpu_s - self.spun_s) / self.cycles * 1e6 if self.cycles else 0.0

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON."""
        values = asdict(self)
        values |= {
            name: getattr(self, name)._asdict() for name in ("lateness", "execution", "exchange", "response")
        }
        values["status"], values["trip"] = self.status.name.lower(), self.trip.name.lower()
        values["rung"] = str(self.rung)
        values["guardian"] = self.guardian._asdict() | {"status": self.guardian.status.name.lower()}
        values["requests_per_cycle"], values["cpu_us_per_cycle"] = (
            self.requests_per_cycle,
            self.cpu_us_per_cycle,
        )
        return values


def loop_result(segment: Segment) -> LoopResult:
    """Read the statistics of a loop, running or ended."""
    words = segment.words
    guardian = segment.guardian()
    stops_ns = [ns for ns in (int(words[Word.STOPPED_NS]), guardian.stopped_ns) if ns]
    stopped_ns = min(stops_ns, default=0)
    tripped_ns = int(words[Word.TRIP_NS])
    return LoopResult(
        status=segment.status,
        trip=segment.trip,
        trip_detail=segment.text("trip"),
        cycles=int(words[Word.CYCLES]),
        missed=int(words[Word.MISSED]),
        grid_length=int(words[Word.GRID_LENGTH]),
        soft_overruns=int(words[Word.SOFT_OVERRUNS]),
        requests=int(words[Word.EXCHANGES]),
        dialect="framed" if words[Word.FRAMED] else "text",
        is_combined=bool(words[Word.COMBINED]),
        rung=list(Rung)[words[Word.RUNG]],
        scheduling=segment.text("grant"),
        is_memory_locked=bool(words[Word.MEMORY_LOCKED]),
        device=segment.text("device"),
        lateness=segment.lateness.percentiles(),
        execution=segment.execution.percentiles(),
        exchange=segment.exchange.percentiles(),
        response=segment.response.percentiles(),
        elapsed_s=words[Word.ELAPSED_NS] * 1e-9,
        cpu_s=words[Word.CPU_NS] * 1e-9,
        spun_s=words[Word.SPUN_NS] * 1e-9,
        guardian=guardian,
        stops_sent=int(words[Word.STOPS_SENT]),
        stop_latency_s=(stopped_ns - tripped_ns) * 1e-9 if tripped_ns and stopped_ns else 0.0,
    )
