"""The doctor's verdict in words: whether the machine can hold the rate, and because of what."""

from dataclasses import dataclass

from hm_driver.realtime.scheduling import Rung
from tools.doctor.finding import Finding, State
from tools.doctor.measurement import LinkMeasurement, Measurement
from tools.jitter.result import ScenarioResult
from tools.jitter.table import microseconds

_FULL = 0.9
"""Share of the period above which a cycle's 99th percentile leaves nothing for anything else."""
_FEW = 0.001
"""Share of missed periods that the limits of the loop take as it goes."""
_STEAL = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What the doctor says."""

    can_hold: bool
    """Whether the machine can hold the rate."""
    text: str
    """Why, in a few sentences."""
    changes: tuple[str, ...]
    """What to change, the most important first, each with its command."""


def judge(
    findings: tuple[Finding, ...],
    measured: Measurement | None,
    link: LinkMeasurement | None,
    *,
    rate_hz: float,
) -> Verdict:
    """Put it all into words.

    Args:
        findings: What the machine allows.
        measured: The loop on this machine, or None where it was not measured.
        link: The link to a device, or None.
        rate_hz: Rate that is to be held [Hz].
    """
    changes = [
        f"{finding.title}: {finding.change}"
        for state in (State.BAD, State.NOTE)
        for finding in findings
        if finding.state is state and finding.change
    ]
    sentences: list[str] = []
    can_hold = True
    if measured is None:
        bad = [finding.title for finding in findings if finding.state is State.BAD]
        can_hold = not bad
        sentences.append(
            f"Nothing was measured. {', '.join(bad)} {'stands' if len(bad) == 1 else 'stand'} in the way."
            if bad else "Nothing was measured, and nothing found that stands in the way."
        )  # fmt: skip
    else:
        can_hold, text = _judge_loop(measured, rate_hz)
        sentences.append(text)
    if link is not None:
        fits, text = _judge_link(link, rate_hz)
        can_hold = can_hold and fits
        sentences.append(text)
    return Verdict(can_hold=can_hold, text=" ".join(sentences), changes=tuple(changes))


def _judge_loop(measured: Measurement, rate_hz: float) -> tuple[bool, str]:
    result = measured.result
    period_us = 1e6 / rate_hz
    spread = result.response
    facts = (
        f"{_granted(result)}; half of the cycles end within {microseconds(spread.p50)} µs of their deadline, "
        f"99 % within {microseconds(spread.p99)} µs of {period_us:g} µs"
    )
    if result.problem:
        return False, f"This machine cannot hold {_rate(rate_hz)}: the loop ended early ({result.problem})."
    if spread.p99 > _FULL * period_us:
        fitting = int(_FULL * 1e6 / spread.p99 / 50) * 50
        return False, (
            f"This machine cannot hold {_rate(rate_hz)} because its cycles take too long: {facts}. "
            f"About {max(fitting, 50)} Hz would fit."
        )
    ran = result.window_cycles + result.window_missed
    own, machine = result.own_missed or 0, result.window_missed - (result.own_missed or 0)
    if own > _FEW * ran:
        return False, (
            f"This machine cannot hold {_rate(rate_hz)} because the loop missed {own} of {ran} periods that "
            f"the canary beside it did not: {facts}. Other real-time threads, or too little privilege, are "
            "the usual reasons."
        )
    text = f"This machine can hold {_rate(rate_hz)} with {facts}."
    if machine > 0:
        longest_ms = max((event.canary for event in result.worst), default=0.0) * 1e-3
        longest_ms = max(longest_ms, result.canary.max * 1e-3)
        text += (
            f" The machine itself stalled: {machine} of {ran} periods were missed by the loop and by a "
            f"canary that does nothing but sleep, the longest stall took {longest_ms:.1f} ms."
        )
    elif own == 0:
        text += f" No period of {ran} was missed."
    if own:
        text += f" {own} of {ran} periods were missed by the loop alone."
    if measured.steal is not None and measured.steal > _STEAL:
        text += f" The host took {measured.steal:.0%} of the CPUs' time meanwhile."
    return True, text


def _judge_link(link: LinkMeasurement, rate_hz: float) -> tuple[bool, str]:
    period_us = 1e6 / rate_hz
    trip = link.round_trip
    facts = f"{microseconds(trip.p50)} µs at the median, {microseconds(trip.p99)} µs at the 99th percentile"
    if trip.p99 > _FULL * period_us:
        fitting = int(_FULL * 1e6 / trip.p99 / 50) * 50
        return False, (
            f"The link to {link.url} cannot hold {_rate(rate_hz)}: a round trip takes {facts}; about "
            f"{max(fitting, 50)} Hz would fit, or a wire without a switch or radio between."
        )
    more = "" if link.is_combined else ", but commands go one by one: each adds a round trip to the cycle"
    return True, f"A round trip to {link.url} takes {facts}{more}."


def _granted(result: ScenarioResult) -> str:
    if result.rung == Rung.FIFO:
        return "real-time scheduling (SCHED_FIFO)"
    return f"the scheduling rung '{result.rung}', and only as long as little else runs"


def _rate(rate_hz: float) -> str:
    return f"{rate_hz / 1e3:g} kHz" if rate_hz >= 1000.0 else f"{rate_hz:g} Hz"
