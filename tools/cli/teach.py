"""``hm teach``: the paper's experiment, in real time or in lock-step."""

import contextlib
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from tools.cli.console import tell, write, write_json, write_table

if TYPE_CHECKING:
    from tools.check.first_run import Approach
    from tools.report import Summary
    from tools.run.request import Outcome, TeachRequest
    from tools.run.view import SessionView

_SWITCH = Parameter(negative="")


def teach(
    *,
    fast: Annotated[bool, _SWITCH] = False,
    device: str | None = None,
    world: str | None = None,
    hand: Literal["simulated", "person"] | None = None,
    method: Literal["paper", "confident", "error", "success", "button"] | None = None,
    learner: Literal["lwr", "multi", "rfwr", "lwpr"] | None = None,
    arbitration: Literal["paper", "confidence", "error", "success", "button"] | None = None,
    practice: float | None = None,
    seed: int = 1,
    config: Path | None = None,
    set_: Annotated[list[str] | None, Parameter(name="--set", negative="")] = None,
    output: Path = Path("sessions"),
    yes_real_robot: Annotated[bool, _SWITCH] = False,
    json: Annotated[bool, _SWITCH] = False,
) -> int:
    """Teach the arm a task: a human demonstrates, the robot learns meanwhile and takes over where it has.

    Without --device an emulator is started, and a simulated person holds its handle. At the end the table of
    the session and the path of its report are printed. Ctrl-C stops the arm and keeps the log.

    Args:
        fast: Run in lock-step on a virtual clock, as fast as it goes; the same seed gives the same log.
        device: Address of a HapticMASTER or of an emulator, tcp://HOST[:7654]; default: start an emulator.
        world: World endpoint of that emulator, the second line that hm emulate prints.
        hand: Who holds the handle: simulated, or person, which is the default with --device alone.
        method: Whole method of teaching: a learner, an arbitration and their numbers; default: paper.
        learner: Another learner than the method's.
        arbitration: Another arbitration than the method's.
        practice: Seconds of practice before teaching, with nothing accumulated; default: the configuration's.
        seed: Seed of everything random.
        config: TOML file; hm config show prints one.
        set_: A value over the file's, as in learner.w_gen=0.7; may be given again.
        output: Directory of the log and of the report.
        yes_real_robot: Confirm the first run on a robot, which is slow and weak, without being asked.
        json: Print the table as one JSON object, and nothing else on standard output.
    """
    from tools.cli.failures import ExitCode

    began = time.monotonic()
    request = _request(
        fast=fast, device=device, world=world, hand=hand, method=method, learner=learner,
        arbitration=arbitration, practice=practice, seed=seed, config=config, overrides=set_ or [],
        output=output,
    )  # fmt: skip
    for warning in request.options.warnings():
        tell(f"note: {warning}")
    request, approach = _approached(request, yes=yes_real_robot)
    outcome = _run(request, fast=fast)
    if approach is not None:
        approach.completed()
    ran_s = time.monotonic() - began
    summary, report = _report(outcome)
    values = _table(request, summary, outcome, report=report, wall_s=time.monotonic() - began)
    if json:
        write_json(values)
    else:
        _print(values, ran_s=ran_s)
    return ExitCode.OK


def _request(
    *,
    fast: bool,
    device: str | None,
    world: str | None,
    hand: str | None,
    method: str | None,
    learner: str | None,
    arbitration: str | None,
    practice: float | None,
    seed: int,
    config: Path | None,
    overrides: list[str],
    output: Path,
) -> "TeachRequest":
    from hm_driver.errors import ConfigurationError
    from hm_driver.transport.urls import parse_device_url
    from teaching.task_file import load_task
    from tools.config import parse_overrides
    from tools.run.options import load_options
    from tools.run.request import HandKind, TeachRequest

    changes = parse_overrides(overrides)
    for key, value in (
        ("method", method),
        ("learner.kind", learner),
        ("arbitration.kind", arbitration),
        ("session.practice", practice),
    ):
        if value is not None:
            changes[key] = str(value)
    if seed < 0:
        raise ConfigurationError("--seed", f"{seed} must not be negative")
    if fast and (device or world):
        raise ConfigurationError(
            "--fast", "runs in lock-step with an emulator of its own; leave --device out"
        )
    if world and not device:
        raise ConfigurationError(
            "--world", "names the world endpoint of the emulator at --device; give that too"
        )
    if device:
        parse_device_url(device)
    options = load_options(config, changes).value
    task = load_task(options.task)
    task.check_reach(options.geometry)
    kind = HandKind(hand) if hand else HandKind.PERSON if device and not world else HandKind.SIMULATED
    if kind is HandKind.SIMULATED and device and not world:
        raise ConfigurationError(
            "--hand", "simulated takes hold through the emulator's world endpoint: give --world"
        )
    if kind is HandKind.PERSON and not device:
        raise ConfigurationError("--hand", "person holds the handle of a device: give --device")
    return TeachRequest(
        options=options, task=task, seed=seed, output=output, hand=kind, device=device, world=world
    )


def _approached(request: "TeachRequest", *, yes: bool) -> "tuple[TeachRequest, Approach | None]":
    """The request with the limits of a first run, where the device is a robot that has not been run yet."""
    from tools.cli.approach import approach_at_terminal

    if request.device is None:
        return request, None
    approach = approach_at_terminal(request.device, world=request.world, yes=yes)
    options = request.options
    modes, limits = approach.reduce(options.modes, options.limits, options.geometry)
    return replace(request, options=replace(options, modes=modes, limits=limits)), approach


def _run(request: "TeachRequest", *, fast: bool) -> "Outcome":
    from tools.live import LiveView
    from tools.run.lockstep import run_lockstep
    from tools.run.real_time import run_real_time
    from tools.run.view import SessionView

    name = _free_name(request.output, f"{'fast' if fast else 'session'}-{request.task.name}-{request.seed}")
    options = request.options
    tell("starting; the first start compiles the numerical kernels, which takes up to half a minute")
    with LiveView() as live:
        view = SessionView(
            live,
            accumulation_length=options.accumulation.N_acc,
            coverage_goal=options.session.autonomy_coverage,
        )
        with _noting_log(request.output / f"{name}.mcap", view):
            return (run_lockstep if fast else run_real_time)(request, view, name=name)


def _free_name(directory: Path, stem: str) -> str:
    """A name that no log of the directory has yet: nothing recorded is ever overwritten."""
    number = 1
    while (directory / f"{stem}-{number:03d}.mcap").exists():
        number += 1
    return f"{stem}-{number:03d}"


@contextlib.contextmanager
def _noting_log(path: Path, view: "SessionView") -> Iterator[None]:
    """Say with any failure of a session that had begun where its log is, and what can be done with it."""
    try:
        yield
    except (Exception, KeyboardInterrupt) as error:
        if view.session is not None and path.exists():
            error.add_note(f"the log is complete up to here: {path}; its report: hm log report {path}")
        raise


def _report(outcome: "Outcome") -> "tuple[Summary, Path]":
    from tools.report import build_report

    path = outcome.log.with_suffix(".html")
    return build_report(outcome.log, path), path


def _table(
    request: "TeachRequest", summary: "Summary", outcome: "Outcome", *, report: Path, wall_s: float
) -> dict[str, Any]:
    """What ``--json`` prints; documented in docs/json.md."""
    ticks = outcome.ticks
    return summary.as_dict() | {
        "method": request.options.method.value,
        "learner": request.options.learner.kind.value,
        "arbitration": request.options.arbitration.kind.value,
        "seed": request.seed,
        "loop": outcome.loop or None,
        "ticks": None
        if ticks is None
        else {
            "lateness_us": ticks.lateness._asdict(),
            "excess_over_canary_max_us": ticks.excess_max_us,
            "missed": ticks.missed,
        },
        "wall_s": wall_s,
        "log": str(outcome.log),
        "report": str(report),
    }


def _print(values: dict[str, Any], *, ran_s: float) -> None:
    speed = values["session_s"] / ran_s
    took = f"{ran_s:.1f} s, {speed:.1f} times real time; {values['wall_s'] - ran_s:.1f} s for the report"
    write_table([*_rows(values), ("took", took)])
    write(f"log     {values['log']}")
    write(f"report  {values['report']}")


def _rows(values: dict[str, Any]) -> Iterator[tuple[str, str]]:
    from tools.report.words import sources

    yield "method", f"{values['method']}: learner {values['learner']}, arbitration {values['arbitration']}"
    yield "of them", sources(values["learner"], values["arbitration"])
    yield "updates", f"{values['updates']} ({values['samples']} samples)"
    yield "models", f"{values['models']} ({values['models_added']} added, {values['models_pruned']} pruned)"
    yield "coverage", f"{100.0 * values['coverage']:.1f} %"
    yield "session", f"{values['session_s']:.1f} s, of them teaching {values['teaching_s']:.1f} s"
    grid, run = values["grid"], values["run"]["force"]
    for place in ("overall", "inside", "border"):
        yield (
            f"force error, {place}",
            f"grid {_newton(grid[place]['mean'])}, run {_newton(run[place]['mean'])}",
        )
    yield "missed periods", f"{values['missed_periods']} of {values['cycles'] + values['missed_periods']}"
    if values["loop"] is not None:
        late = values["loop"]["lateness"]
        yield (
            "loop lateness",
            f"p50 {late['p50_us']:.1f} us, p99 {late['p99_us']:.1f} us, max {late['max_us']:.0f} us",
        )
        yield "scheduling", values["loop"]["scheduling"]
        yield (
            "100 Hz ticks",
            (
                f"at most {values['ticks']['excess_over_canary_max_us'] / 1e3:.2f} ms later than a canary, "
                f"{values['ticks']['missed']} missed"
            ),
        )


def _newton(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} N"
