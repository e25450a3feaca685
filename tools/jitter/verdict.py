"""Which limits a run has kept."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from tools.jitter.options import Limits
from tools.jitter.result import ScenarioResult


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One limit of one scenario."""

    scenario: str
    name: str
    """What is limited, with its unit."""
    value: float
    """What was reached."""
    limit: float
    """What is allowed."""
    passed: bool
    detail: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)

    def describe(self) -> str:
        """One line for a person."""
        relation = "is within" if self.passed else "is beyond"
        text = f"{self.scenario}: {self.name}: {self.value:.4g} {relation} {self.limit:g}"
        return text + (f" ({self.detail})" if self.detail else "")


def judge(result: ScenarioResult, limits: Limits) -> tuple[Check, ...]:
    """Hold one scenario against the limits."""
    return tuple(_checks(result, limits))


def _checks(result: ScenarioResult, limits: Limits) -> Iterator[Check]:
    name, ran = result.name, result.window_cycles + result.window_missed
    wanted = round(result.duration_s * result.rate_hz)
    yield Check(
        scenario=name, name="deadlines not measured", value=wanted - ran, limit=0,
        passed=ran == wanted and not result.problem, detail=result.problem,
    )  # fmt: skip
    if result.excess.samples:
        yield _at_most(name, "excess p99.9 [µs]", result.excess.p99_9, limits.excess_p99_9_us)
        if limits.excess_max_us is not None:
            yield _at_most(name, "excess max [µs]", result.excess.max, limits.excess_max_us)
    if result.own_missed is not None and limits.own_missed is not None:
        yield _at_most(name, "deadlines missed that no canary missed", result.own_missed, limits.own_missed)
    drift = max(0.0, abs(result.drift_us_per_s) - result.drift_resolution_us_per_s)
    yield _at_most(name, "drift beyond its resolution [µs/s]", drift, limits.drift_us_per_s)
    difference = result.cycles + result.missed - result.grid_length
    yield Check(
        scenario=name, name="cycles + missed - length of the grid", value=difference, limit=0,
        passed=result.has_identity,
    )  # fmt: skip
    if limits.lateness_p50_us is not None:
        yield _at_most(name, "lateness p50 [µs]", result.lateness.p50, limits.lateness_p50_us)


def _at_most(scenario: str, name: str, value: float, limit: float) -> Check:
    return Check(scenario=scenario, name=name, value=value, limit=limit, passed=value <= limit)
