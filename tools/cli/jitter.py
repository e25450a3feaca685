"""``hm jitter``: how punctual the loop is on this machine, beside whatever a program does meanwhile."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Parameter

from tools.cli.console import tell, write, write_json

if TYPE_CHECKING:
    from tools.jitter.options import Scenario
    from tools.jitter.result import Run

app = App(name="jitter", result_action="return_value", suppress_keyboard_interrupt=False)
_SWITCH = Parameter(negative="")
_SOAK_SCENARIO = "spinner+interface+recording"
_SOAK_S = 3600.0
_USUAL_HZ, _FAST_SHARE = 1000.0, 0.001


@app.default
def jitter(
    *,
    rate: float = 1000.0,
    duration: float | None = None,
    scenario: Annotated[list[str] | None, Parameter(negative="")] = None,
    device: str | None = None,
    world: str | None = None,
    yes_real_robot: Annotated[bool, _SWITCH] = False,
    loop: Literal["process", "thread"] = "process",
    unprivileged: Annotated[bool, _SWITCH] = False,
    spin: float = 0.15,
    cpu: int | None = None,
    soak: Annotated[bool, _SWITCH] = False,
    cyclictest: Annotated[bool, _SWITCH] = False,
    slices: int = 10,
    slice_: Annotated[float, Parameter(name="--slice")] = 2.0,
    inject: Literal["sleep", "relative"] | None = None,
    excess_p99_9: Annotated[float, Parameter(name="--excess-p99.9")] = 100.0,
    excess_max: float | None = None,
    own_missed: int | None = None,
    drift: float = 1.0,
    output: Path | None = None,
    trace: Path | None = None,
    json: Annotated[bool, _SWITCH] = False,
) -> int:
    """Measure how punctual the loop is, and say whether that is good.

    The real loop runs in a process of its own against an emulator in another, beside a load. A canary sleeps
    to the same deadlines on the loop's CPU at a higher priority: what the loop is later than the canary is
    its own doing, whatever else the machine runs. The exit code is 1 where a limit was exceeded.

    Args:
        rate: Cycles in a second, 100 to 2500.
        duration: Seconds of each scenario; 10 if left out.
        scenario: What runs beside the loop: none, spinner (a busy Python thread), numpy, interface (60 frames
            a second), gil (C calls that hold the interpreter lock), gc (of a large heap), recording (5000
            messages a second), load (on every core), all, or several joined by +. May be given again; by
            default each alone and then all.
        device: Address of a HapticMASTER or of an emulator, tcp://HOST[:7654]; default: start an emulator.
            The arm is brought into state force and is not moved.
        world: World endpoint of that emulator; without it the device is taken for a robot.
        yes_real_robot: Confirm the first run on a robot, which is slow and weak, without being asked.
        loop: Where the loop runs; thread is the fallback that shares the application's interpreter.
        unprivileged: Let the loop give up every privilege first, and hold its median lateness against 30 µs.
        spin: Largest share of a core that the loop may spin for punctuality, 0 to 0.5.
        cpu: CPU of the loop; default: the last one.
        soak: An hour beside spinner+interface+recording, one missed deadline of our own allowed.
        cyclictest: Let cyclictest, the loop and the loop without spin take turns, and compare them.
        slices: How many turns each of them takes.
        slice_: Length of a turn [s].
        inject: Put a fault into the loop, to see it found: a law that sleeps, or a grid of relative sleeps.
        excess_p99_9: Limit of the lateness beyond the canary's, 99.9th percentile [µs].
        excess_max: Limit of the largest lateness beyond the canary's [µs]; 300, in a soak none.
        own_missed: Limit of the deadlines missed that no canary missed; 0, in a soak 1, above 1 kHz 0.1 %.
        drift: Limit of the drift [µs/s].
        output: Directory for run.json and report.html.
        trace: File for the cycles, to be opened in https://ui.perfetto.dev.
        json: One JSON object instead of the tables.
    """
    from hm_driver.errors import ConfigurationError
    from hm_driver.geometry import ArmGeometry
    from tools.cli.approach import approach_at_terminal
    from tools.cli.failures import ExitCode
    from tools.jitter.cyclictest import SliceOptions, find_cyclictest
    from tools.jitter.options import Fault, JitterOptions, Limits, LoopKind
    from tools.jitter.perfetto import TraceFile
    from tools.jitter.suite import run_suite
    from tools.jitter.table import print_run

    seconds = duration if duration is not None else _SOAK_S if soak else 10.0
    limits = Limits(
        excess_p99_9_us=excess_p99_9,
        excess_max_us=excess_max if excess_max is not None or soak else 300.0,
        own_missed=own_missed if own_missed is not None else _own_missed(rate, seconds, soak=soak),
        drift_us_per_s=drift,
        lateness_p50_us=30.0 if unprivileged else None,
    )
    options = JitterOptions(
        scenarios=_scenarios(scenario, soak=soak),
        rate_hz=rate,
        duration_s=seconds,
        device=device or "",
        loop=LoopKind(loop),
        fault=Fault(inject or ""),
        is_unprivileged=unprivileged,
        spin_duty=spin,
        cpu=cpu,
        limits=limits,
    )
    if cyclictest:
        find_cyclictest()
    for option, path in (("--output", output and output / "run.json"), ("--trace", trace)):
        if path is not None:
            _check_writable(path, option)
    approach = None
    if device is not None:
        approach = approach_at_terminal(device, world=world, yes=yes_real_robot)
        modes, motion = approach.reduce(options.modes, options.motion, ArmGeometry())
        options = replace(options, modes=modes, motion=motion, is_robot=bool(approach.host))
    elif world is not None:
        raise ConfigurationError(
            "--world", "names the world endpoint of the emulator at --device; give that too"
        )
    traced = None if trace is None else TraceFile(trace)
    done = run_suite(
        options,
        tell=tell,
        cyclictest=SliceOptions(slices=slices, slice_s=slice_) if cyclictest else None,
        trace=traced,
    )
    if approach is not None and not any(result.problem for result in done.scenarios):
        approach.completed()
    if traced is not None:
        traced.write()
        tell(f"trace: {traced.path}; open it in https://ui.perfetto.dev")
    if output is not None:
        _save(done, output)
    if json:
        write_json(done.as_dict())
    else:
        print_run(done)
    return ExitCode.OK if done.has_passed else ExitCode.FAILED


@app.command
def compare(
    before: Path,
    after: Path,
    /,
    *,
    picture: Path | None = None,
    json: Annotated[bool, _SWITCH] = False,
) -> None:
    """Print the ratios of two runs, quantity by quantity, and draw them.

    Args:
        before: A run.json, or the directory that holds one.
        after: The other.
        picture: HTML file of the picture; default: compare.html beside the second run.
        json: One JSON object instead of the table; no picture unless --picture asks for it.
    """
    from tools.jitter.compare import compare_runs, print_comparison
    from tools.jitter.page import save_comparison

    comparison = compare_runs(_load(before), _load(after), names=(str(before), str(after)))
    path = picture
    if path is None and not json:
        path = (after if after.is_dir() else after.parent) / "compare.html"
    if path is not None:
        save_comparison(comparison, path)
    if json:
        write_json(comparison.as_dict())
        return
    print_comparison(comparison)
    write(f"picture: {path}")


def _check_writable(path: Path, option: str) -> None:
    """Refuse a file that cannot be written before an hour was spent on what goes into it."""
    from hm_driver.errors import ConfigurationError

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        is_new = not path.exists()
        with path.open("a"):
            pass
        if is_new:
            path.unlink()
    except OSError as error:
        raise ConfigurationError(option, f"{path} cannot be written: {error.strerror}") from error


def _load(path: Path) -> "Run":
    from tools.jitter.result import Run

    return Run.load(path / "run.json" if path.is_dir() else path)


def _own_missed(rate: float, seconds: float, *, soak: bool) -> int:
    """How many deadlines the loop may miss by its own doing."""
    return int(_FAST_SHARE * rate * seconds) if rate > _USUAL_HZ else 1 if soak else 0


def _scenarios(names: list[str] | None, *, soak: bool) -> "tuple[Scenario, ...]":
    from tools.jitter.options import ALL, Load, parse_scenario

    wanted = names or ([_SOAK_SCENARIO] if soak else [*Load, ALL])
    return tuple(parse_scenario(name) for name in wanted)


def _save(done: "Run", directory: Path) -> None:
    from tools.jitter.page import save_report

    done.save(directory / "run.json")
    save_report(done, directory / "report.html")
    tell(f"run: {directory / 'run.json'}, report: {directory / 'report.html'}")
