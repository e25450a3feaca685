"""The doctor's measurements: the loop on this machine for some seconds, and the round trip of a link."""

import threading
import time
from dataclasses import asdict, dataclass
from typing import Any

from hm_driver.device.link import CommandLink, connect_link
from hm_driver.errors import DeviceError, HapticMasterError, ProtocolError, TransportTimeout
from hm_driver.protocol.framing import Dialect
from hm_driver.realtime.histogram import Histogram
from hm_driver.realtime.options import TimingOptions
from hm_driver.realtime.scheduling import enter_realtime
from tools.doctor.kernel import steal_ticks
from tools.jitter.options import JitterOptions, Scenario
from tools.jitter.result import ScenarioResult
from tools.jitter.rig import choose_cpus, device_of, run_scenario
from tools.jitter.spread import Spread, new_histogram

QUESTION = "get state"
"""The exchange that is timed: it changes nothing, whatever the device does."""
_PACE_S = 0.002


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """The loop against an emulator on this machine."""

    result: ScenarioResult
    steal: float | None
    """Share of the CPUs' time that the host took meanwhile; None where it is not told."""

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        result = asdict(self.result)
        for name in ("course", "worst", "own_misses_s"):
            del result[name]
        return result | {"steal": self.steal}


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkMeasurement:
    """The link to a device."""

    url: str
    dialect: str
    is_combined: bool
    """Whether one request may hold several commands."""
    state: str
    """State of the device."""
    exchanges: int
    round_trip: Spread
    """Question out to reply in [µs]."""

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)


def measure_loop(*, seconds: float, rate_hz: float) -> Measurement:
    """Run the loop against an emulator of our own, with nothing beside it.

    Args:
        seconds: How long [s].
        rate_hz: Rate of the loop [Hz].

    Raises:
        HapticMasterError: The loop did not start.
    """
    scenario = Scenario(name="none", loads=())
    options = JitterOptions(scenarios=(scenario,), rate_hz=rate_hz, duration_s=seconds)
    cpus = choose_cpus(None)
    with device_of(options, cpus) as url:
        before = steal_ticks()
        result = run_scenario(scenario, options, url, cpus)
        after = steal_ticks()
    steal = None
    if before is not None and after is not None and after[1] > before[1]:
        steal = (after[0] - before[0]) / (after[1] - before[1])
    return Measurement(result=result, steal=steal)


def measure_link(url: str, *, exchanges: int) -> LinkMeasurement:
    """Time harmless questions, one every 2 ms.

    Args:
        url: The device.
        exchanges: How many.

    Raises:
        TransportError: Nothing listens there, or it stopped to answer.
        ProtocolError: It is no HapticMASTER.
    """
    link = connect_link(url)
    try:
        state = link.ask(QUESTION).strip('" ')
        is_combined = _combines(link)
        histogram = _time_exchanges(link, exchanges)
    finally:
        link.close()
    return LinkMeasurement(
        url=url,
        dialect=link.dialect.value,
        is_combined=is_combined,
        state=state,
        exchanges=exchanges,
        round_trip=Spread.of(histogram),
    )


def _combines(link: CommandLink) -> bool:
    """Whether the device answers two questions in one request."""
    if link.dialect is not Dialect.TEXT:
        return False
    try:
        link.exchange_joined(f"{QUESTION}; {QUESTION}", 2)
    except (DeviceError, ProtocolError, TransportTimeout):
        link.reconnect()
        return False
    return True


def _time_exchanges(link: CommandLink, exchanges: int) -> Histogram:
    """Time the exchanges in a thread that is scheduled as the loop is."""
    histogram = new_histogram()
    errors: list[HapticMasterError] = []

    def run() -> None:
        granted = enter_realtime(TimingOptions().priority)
        due = time.monotonic()
        try:
            for _ in range(exchanges):
                due = max(due + _PACE_S, time.monotonic())
                time.sleep(max(0.0, due - time.monotonic()))
                began_ns = time.monotonic_ns()
                link.exchange(QUESTION)
                histogram.record(time.monotonic_ns() - began_ns)
        except HapticMasterError as error:
            errors.append(error)
        finally:
            granted.release()

    thread = threading.Thread(target=run, name="round trips")
    thread.start()
    thread.join()
    if errors:
        raise errors[0]
    return histogram
