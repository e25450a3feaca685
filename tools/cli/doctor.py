"""``hm doctor``: what this machine allows the loop, and what to change."""

from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from tools.cli.console import tell, write, write_json

if TYPE_CHECKING:
    from tools.doctor.finding import Finding
    from tools.doctor.measurement import LinkMeasurement, Measurement
    from tools.doctor.verdict import Verdict

_SWITCH = Parameter(negative="")
_LONGEST_S, _MOST_EXCHANGES = 3600.0, 100_000


def doctor(
    *,
    rate: float = 1000.0,
    seconds: float = 10.0,
    device: str | None = None,
    exchanges: int = 1000,
    json: Annotated[bool, _SWITCH] = False,
) -> int:
    """Say what this machine allows the loop, measure it, and say what to change.

    The loop runs against an emulator of its own. A device that is named is only asked for its state. The
    exit code is 1 where the machine or the link cannot hold the rate.

    Args:
        rate: Rate to hold [Hz], 100 to 2500.
        seconds: How long to measure [s]; 0 measures nothing.
        device: Address of a HapticMASTER or of an emulator, tcp://HOST[:7654], whose link is measured too.
        exchanges: How many round trips to it.
        json: One JSON object instead.
    """
    from hm_driver.errors import ConfigurationError
    from tools.cli.failures import ExitCode
    from tools.doctor.kernel import kernel_findings
    from tools.doctor.measurement import measure_link, measure_loop
    from tools.doctor.rights import rights_findings
    from tools.doctor.verdict import judge
    from tools.jitter.options import check_rate

    check_rate(rate)
    if seconds and not 1.0 <= seconds <= _LONGEST_S:
        raise ConfigurationError(
            "--seconds", f"{seconds:g} s is outside 1 to {_LONGEST_S:g} s; 10 is usual, 0 measures nothing"
        )
    if not 1 <= exchanges <= _MOST_EXCHANGES:
        raise ConfigurationError(
            "--exchanges", f"{exchanges} is outside 1 to {_MOST_EXCHANGES}; 1000 is usual"
        )
    findings = (*rights_findings(), *kernel_findings())
    link = None
    if device is not None:
        tell(f"timing {exchanges} round trips to {device}")
        link = measure_link(device, exchanges=exchanges)
    measured = None
    if seconds:
        tell(f"running the loop at {rate:g} Hz for {seconds:g} s")
        measured = measure_loop(seconds=seconds, rate_hz=rate)
    verdict = judge(findings, measured, link, rate_hz=rate)
    if json:
        write_json(
            {
                "can_hold": verdict.can_hold,
                "verdict": verdict.text,
                "changes": list(verdict.changes),
                "findings": [finding.as_dict() for finding in findings],
                "measurement": None if measured is None else measured.as_dict(),
                "link": None if link is None else link.as_dict(),
            }
        )
    else:
        _print(findings, measured, link, verdict)
    return ExitCode.OK if verdict.can_hold else ExitCode.FAILED


def _print(
    findings: "tuple[Finding, ...]",
    measured: "Measurement | None",
    link: "LinkMeasurement | None",
    verdict: "Verdict",
) -> None:
    from tools.jitter.table import PERCENTILES, QUANTITIES, facts, microseconds, percentiles, print_table

    width = max(len(finding.title) for finding in findings)
    for finding in findings:
        mark = {"good": "ok", "note": "note", "bad": "BAD", "unknown": "-"}[finding.state]
        write(f"{mark:<5}{finding.title:<{width}}  {finding.value}")
        if finding.why:
            write(f"{'':<5}{'':<{width}}  {finding.why}")
    if measured is not None:
        result = measured.result
        write("")
        print_table(
            f"the loop at {result.rate_hz:g} Hz for {result.duration_s:g} s  [µs]",
            ("", *PERCENTILES),
            [
                (title, *map(microseconds, percentiles(spread)))
                for name, title in QUANTITIES
                if (spread := getattr(result, name)).samples
            ],
        )
        for line in facts(result):
            write(f"  {line}")
        if measured.steal is not None:
            write(f"  the host took {measured.steal:.2%} of the CPUs' time (steal)")
    if link is not None:
        write("")
        print_table(
            f"{link.url}: {link.dialect} dialect, state {link.state}, "
            f"{'several commands in one request' if link.is_combined else 'one command a request'}  [µs]",
            ("", *PERCENTILES),
            [("round trip", *map(microseconds, percentiles(link.round_trip)))],
        )
    write("")
    write(verdict.text)
    if verdict.changes:
        write("What can be changed, the most important first:")
        for number, change in enumerate(verdict.changes, 1):
            write(f"{number:3}. {change}")
