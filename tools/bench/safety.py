"""How soon the arm is stopped: ``python -m tools.bench.safety``, about six minutes.

Prints a row for each event of docs/safety.md: median and worst time to the acknowledged stop, and the worst
beyond what canaries saw of the machine's own stalls. The emulator goes on when its client vanishes, and its
own time stamps are what is measured. Behind the emergency button the arm has no power, and the device refuses
the stop; there the refusal is what counts.
"""

import json as json_module
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Annotated, Any

from cyclopts import App, Parameter

from hm_driver.errors import LoopError
from hm_driver.geometry import ArmGeometry
from hm_driver.realtime.modes import LimitOptions
from hm_driver.realtime.options import LoopOptions, TimingOptions, WatchOptions
from tools.bench.safety_rig import Application, Rig, StarvedError, Stop, Vectors
from tools.cli.console import tell, write

LIMIT_S = 0.02
"""From a limit that is exceeded to the acknowledged stop [s]."""
LOST_S = 0.1
"""From the loss of the application, of the loop or of the device's data to the acknowledged stop [s]."""

PULL = 20.0
"""With which the hand pulls against the position springs, so that there is a force to ramp down [N]."""

_STARVED = 4
_STARVATION = ("heartbeat", "deadline")
_CEILING = 0.02
_SLOW = 0.04
_LAWS = "tools.bench.safety_laws"


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """One thing that must end in a stop."""

    strike: Callable[[Rig, Application], float]
    """Causes it; returns the device time just before [s]."""
    allowed_s: float = LIMIT_S
    """Longest time to the acknowledged stop [s]."""
    reasons: tuple[str, ...]
    """Trips of which one is told; an empty text where the application cannot tell."""
    options: dict[str, Any] = field(default_factory=dict)
    """Fields of the loop's options."""
    query: str = ""
    """Behind the device's address."""
    shows: Callable[[Vectors], bool] | None = None
    """Tells from a measurement whether it has happened; None: it happens when it is caused."""


def _inject(kind: str, **value: Any) -> Callable[[Rig, Application], float]:  # noqa: ANN401  # of any fault
    return lambda rig, _: rig.world.inject(kind, **value).time_s


def _signal(number: int, *, to_loop: bool) -> Callable[[Rig, Application], float]:
    def strike(rig: Rig, application: Application) -> float:
        time_s = rig.world.observe().time_s
        (application.kill_loop if to_loop else application.kill)(number)
        return time_s

    return strike


def _lift(rig: Rig, _: Application) -> float:
    return rig.hold(0.05, stiffness=100.0).time_s


def _hold_up(rig: Rig, application: Application) -> float:
    """Stop the loop for more periods than may be missed, and for less than the guardian bears."""
    time_s = rig.world.observe().time_s
    application.kill_loop(signal.SIGSTOP)
    time.sleep(0.05)
    application.kill_loop(signal.SIGCONT)
    return time_s


def _is_high(vectors: Vectors) -> bool:
    return vectors[0][2] > _CEILING


def _is_fast(vectors: Vectors) -> bool:
    return abs(vectors[1][2]) > _SLOW


EVENTS: dict[str, Event] = {
    "workspace": Event(
        strike=_lift,
        shows=_is_high,
        reasons=("workspace",),
        options={
            "geometry": ArmGeometry(z_max=_CEILING),
            "limits": LimitOptions(workspace_margin=0.0, velocity_z=1.0),
        },
    ),
    "velocity": Event(
        strike=_lift,
        shows=_is_fast,
        reasons=("velocity",),
        options={"limits": LimitOptions(velocity_z=_SLOW / 2.0, velocity_trip=2.0)},
    ),
    "force": Event(strike=_inject("force_bias", value=(0.0, 0.0, 120.0)), reasons=("force",)),
    "force (frames at 250 Hz)": Event(
        strike=_inject("force_bias", value=(0.0, 0.0, 120.0)),
        reasons=("force",),
        options={"timing": TimingOptions(rate_hz=250.0)},
        query="?dialect=framed",
    ),
    "force (100 Hz)": Event(
        strike=_inject("force_bias", value=(0.0, 0.0, 120.0)),
        reasons=("force",),
        options={"timing": TimingOptions(rate_hz=100.0)},
    ),
    "deadlines missed": Event(
        strike=_hold_up,
        allowed_s=LOST_S,
        reasons=("deadline", "loop_lost"),
        options={"watch": WatchOptions(missed_s=0.04)},
    ),
    "refused command": Event(strike=_inject("reply_error", value=1.0, duration_s=0.002), reasons=("device",)),
    "emergency button": Event(strike=_inject("emergency_button"), allowed_s=LOST_S, reasons=("device",)),
    "connections reset": Event(
        strike=_inject("connection_reset"), allowed_s=LOST_S, reasons=("link", "loop_lost")
    ),
    "law raises": Event(
        strike=lambda rig, _: rig.hold(0.03).time_s,
        reasons=("law",),
        options={"law": f"{_LAWS}:RaisesAbove"},
        shows=lambda vectors: vectors[0][2] > 0.01,
    ),
    "law blocks": Event(
        strike=lambda rig, _: rig.hold(0.03).time_s,
        allowed_s=LOST_S,
        reasons=("loop_lost", "law"),
        options={"law": f"{_LAWS}:BlocksAbove"},
        shows=lambda vectors: vectors[0][2] > 0.01,
    ),
    "application killed": Event(
        strike=_signal(signal.SIGKILL, to_loop=False), allowed_s=LOST_S, reasons=("",)
    ),
    "application stopped": Event(
        strike=_signal(signal.SIGSTOP, to_loop=False), allowed_s=LOST_S, reasons=("",)
    ),
    "loop killed": Event(
        strike=_signal(signal.SIGKILL, to_loop=True), allowed_s=LOST_S, reasons=("loop_lost",)
    ),
    "loop stopped": Event(
        strike=_signal(signal.SIGSTOP, to_loop=True), allowed_s=LOST_S, reasons=("loop_lost",)
    ),
}
"""Every event that can be caused from outside, by name."""


def run_event(rig: Rig, event: Event) -> Stop:
    """Bring the device up, let the event strike, and measure.

    Where the machine itself kept loop or application from their work, the arm is stopped before the event,
    or for that reason; that is tried again, `_STARVED` times.

    Raises:
        LoopError: The loop did not start, or the device was not stopped.
    """
    for _ in range(_STARVED):
        try:
            stop = _run_once(rig, event)
        except StarvedError:
            continue
        if stop.reason in event.reasons or stop.reason not in _STARVATION:
            return stop
    return _run_once(rig, event)


def _run_once(rig: Rig, event: Event) -> Stop:
    rig.park()
    options = LoopOptions(url=rig.url + event.query, **event.options)
    application = Application(options, engage_x=1.0, engage_y=1.0)
    try:
        time.sleep(0.2)
        rig.pull = PULL
        rig.hold()
        time.sleep(0.2)
        tells = event.reasons != ("",)
        return rig.stop_after(application, event.strike, shows=event.shows, tells=tells)
    finally:
        application.close()
        rig.world.clear_faults()


app = App(name="safety", help=__doc__, version_flags=[])


@app.default
def main(*, repeat: int = 10, only: str = "", json: Annotated[bool, Parameter(negative="")] = False) -> int:
    """Print the matrix.

    Args:
        repeat: How many times each event is caused.
        only: Names of events, with commas; default: all.
        json: Print every measurement as one JSON object instead.
    """
    names = [name.strip() for name in only.split(",") if name.strip()] or list(EVENTS)
    width = max(map(len, names))
    all_stops = {}
    if not json:
        write(f"{'event':<{width}}  allowed | p50 | max | max beyond stalls [ms] | told as")
    with tempfile.TemporaryDirectory() as directory, Rig(Path(directory)) as rig:
        for name in names:
            stops = []
            for _ in range(repeat):
                try:
                    stops.append(run_event(rig, EVENTS[name]))
                except LoopError as error:
                    tell(f"{name}: {error}")
            all_stops[name] = [stop._asdict() | {"excess_s": stop.excess_s} for stop in stops]
            if not json:
                write(f"{name:<{width}}  {_row(EVENTS[name], stops)}")
    if json:
        write(json_module.dumps(all_stops))
    return 0


def _row(event: Event, stops: list[Stop]) -> str:
    if not stops:
        return "never measured"
    latencies = [1e3 * stop.latency_s for stop in stops]
    excess = max(1e3 * stop.excess_s for stop in stops)
    told = ", ".join(sorted({stop.reason or "-" for stop in stops}))
    verdict = "" if excess <= 1e3 * event.allowed_s else "  TOO LATE"
    figures = (1e3 * event.allowed_s, median(latencies), max(latencies), excess)
    return " | ".join(f"{figure:.1f}" for figure in figures) + f" | {told}{verdict}"


if __name__ == "__main__":
    app()
