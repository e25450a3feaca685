"""``hm check``: compare a robot with what docs/fidelity.md says about it."""

import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from tools.cli.console import tell, write, write_json, write_table

if TYPE_CHECKING:
    from tools.check.comparison import Finding

_SWITCH = Parameter(negative="")


def check(
    *,
    device: str,
    active: Annotated[bool, _SWITCH] = False,
    yes_real_robot: Annotated[bool, _SWITCH] = False,
    output: Path | None = None,
    json: Annotated[bool, _SWITCH] = False,
) -> int:
    """Compare a device with the fidelity table, and write a file to send in.

    First come questions alone: nothing moves, and the state stays. With --active objects are made, changed
    and removed again, in the states off and stop alone and never enabled. Exit code 0: everything that could
    be asked is as the table says; 1: something differs; 2: not confirmed; 3: the device cannot be reached.

    Args:
        device: Address of the device, tcp://HOST[:7654].
        active: Make, change and remove objects too.
        yes_real_robot: Confirm that without being asked.
        output: File of the comparison; default: hm-check-DATE.json here.
        json: Print the findings as one JSON object, and nothing else on standard output.
    """
    from hm_driver.device.link import connect_link
    from hm_driver.protocol.replies import parse_word
    from tools.check.active import ACTIVE
    from tools.check.comparison import Conversation, Verdict, compare
    from tools.check.passive import PASSIVE
    from tools.check.record import build_record, count, write_record
    from tools.cli.failures import ExitCode

    if active and not yes_real_robot:
        _confirm()

    def reopen() -> str:
        second = connect_link(device)
        try:
            return parse_word(second.ask("get state"))
        finally:
            second.close()

    path = output or Path(f"hm-check-{datetime.now(UTC):%Y%m%d-%H%M%S}.json")
    link = connect_link(device)
    conversation = Conversation(link, reopen=reopen)
    findings: list[Finding] = []
    try:
        findings += compare(conversation, PASSIVE)
        if active:
            findings += compare(conversation, ACTIVE)
    finally:
        link.close()
        record = build_record(conversation, findings, active=active)
        write_record(record, path)
        tell(f"every command and reply is in {path}; please send it in with an issue")
    if json:
        write_json({"counts": record["counts"], "findings": record["findings"], "file": str(path)})
    else:
        _print(findings)
    return ExitCode.FAILED if count(findings, Verdict.DIFFERS) else ExitCode.OK


def _confirm() -> None:
    from hm_driver.errors import ConfigurationError

    tell("--active makes, changes and removes objects on the device, all named hmcheck, and enables none.")
    tell("It sets the virtual mass to what it is. Nothing should move; have the emergency button at hand.")
    if sys.stdin.isatty() and sys.stderr.isatty():
        sys.stderr.write("Type yes to go on: ")
        sys.stderr.flush()
        if sys.stdin.readline().strip().lower() == "yes":
            return
    raise ConfigurationError("--active", "nobody confirmed it: --yes-real-robot")


def _print(findings: "list[Finding]") -> None:
    from tools.check.comparison import Verdict
    from tools.check.record import count

    write_table([(finding.question, f"{finding.verdict.value:<8} {finding.got}") for finding in findings])
    odd = [finding for finding in findings if finding.verdict is not Verdict.SAME]
    if odd:
        write("")
    for finding in odd:
        write(f"{finding.question} {finding.verdict.value}: table ({finding.confidence}): {finding.fact}")
        write(f"    expected  {finding.expected}")
        write(f"    got       {finding.got}")
    write("")
    write(", ".join(f"{count(findings, verdict)} {verdict.value}" for verdict in Verdict))
