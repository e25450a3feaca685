"""What the emulator costs: ``python -m tools.bench.emulator``, a minute.

Prints ratios, not verdicts: device time over processor time in lock-step, machine code over plain Python, and
the share of a core that the emulator uses on the wall clock. What is compared alternates within one run, and
medians are told, so that a busy machine disturbs little.
"""

import time
from collections.abc import Callable
from statistics import median
from typing import NamedTuple

from cyclopts import App

from emulator.arm_model import ArmModel
from emulator.canary import Canary
from emulator.in_process import LockstepEmulator
from emulator.parameters import load_parameters
from emulator.process import Emulator
from hm_driver.device.link import CommandLink, connect_link
from tools.cli.console import tell, write

STEP_RATE_HZ = 2500
CYCLE = "get measpos; get modelvel; get measforce; set b force [0.1,0,0]"
"""What a program asks in each cycle of 1 ms."""

_SPRINGS = [
    f"create spring {name}; set {name} stiffness 500; set {name} dampfactor 0.7; set {name} enable"
    for name in ("x", "y", "z", "skill")
]
_BIAS = ["create biasforce b; set b force [0.1,0,0]; set b enable"]
_EFFECTS = ["spring"] * 9 + ["damper"] * 3 + ["biasforce", "shaker"]
_SHAPES = ["block", "sphere", "flatplane", "cylinder", "torus"]
_EFFECT = "create {0} {1}; set {1} pos [0,0,0.01]; set {1} enable"
_SHAPE = "create {0} {1}; set {1} pos [0,0,-0.15]; set {1} stiffness 2000; set {1} enable"

OBJECTS: dict[str, list[str]] = {
    "none": [],
    "4 springs": _SPRINGS,
    "4 springs and a bias force": [*_SPRINGS, *_BIAS],
    "20 of all types": [
        *_BIAS,
        *(_EFFECT.format(kind, f"o{i}") for i, kind in enumerate(_EFFECTS)),
        *(_SHAPE.format(kind, f"s{i}") for i, kind in enumerate(_SHAPES)),
    ],
}
"""Commands that create and enable the objects; the third set is the paper's."""

_HAND = {"position": [0.0, 0.0, -0.02], "stiffness": [300.0] * 3, "damping": [20.0] * 3}
_MILLISECOND_NS = 1_000_000


class Speeds(NamedTuple):
    """Device seconds per second of processor time, medians."""

    steps: float
    """The arm alone, many steps at a time."""
    milliseconds: float
    """A millisecond at a time, as a control loop lets time pass."""
    cycles: float
    """The same with a request of four commands each millisecond, answered as text; 0 without objects."""
    plain: float
    """As ``steps``, in plain Python."""


class Shares(NamedTuple):
    """The emulator's process on the wall clock; medians over the seconds."""

    idle: float
    """Share of a core while nobody asks [%]."""
    asked: float
    """Share of a core with `CYCLE` a thousand times a second [%]."""
    periods: int
    """Periods of 400 µs looked at."""
    missed: int
    """Of them without a tick of their own."""
    canary: int
    """Missed by a canary beside it."""


def measure_speeds(commands: list[str], *, rounds: int, device_s: float) -> Speeds:
    """Run an arm with objects in lock-step.

    Args:
        commands: Requests that create the objects.
        rounds: How often to take turns.
        device_s: Device time of a turn of the machine code [s]; plain Python gets a fortieth.
    """
    emulator = LockstepEmulator()
    _bring_up(lambda text: emulator.handle(f"{text}\n".encode()).decode(), commands, emulator)
    emulator.world.exchange(_HAND)
    arm = emulator.device.arm
    plain = ArmModel(load_parameters(), seed=0, compiled=False)
    plain.effects = arm.effects
    plain.state[:], plain.params[:] = arm.state, arm.params
    request = CYCLE.encode() + b"\n" if "b" in emulator.device.objects else b""
    steps, short = round(device_s * STEP_RATE_HZ), round(device_s * STEP_RATE_HZ / 40)

    def pass_milliseconds(request: bytes) -> None:
        now_ns = emulator.device.step * _MILLISECOND_NS * 1000 // STEP_RATE_HZ
        for _ in range(steps * 1000 // STEP_RATE_HZ):
            now_ns += _MILLISECOND_NS
            emulator.advance_to_ns(now_ns)
            if request:
                emulator.handle(request)

    turns: list[tuple[Callable[[], object], float]] = [
        (lambda: emulator.device.advance(steps), device_s),
        (lambda: pass_milliseconds(b""), device_s),
        (lambda: pass_milliseconds(request) if request else None, device_s if request else 0.0),
        (lambda: plain.step(short), short / STEP_RATE_HZ),
    ]
    speeds: list[list[float]] = [[] for _ in turns]
    for _ in range(rounds):
        for kept, (run, seconds) in zip(speeds, turns, strict=True):
            start_ns = time.thread_time_ns()
            run()
            kept.append(seconds * 1e9 / max(1, time.thread_time_ns() - start_ns))
    return Speeds(*(median(kept) for kept in speeds))


def measure_shares(commands: list[str], *, seconds: int) -> Shares:
    """Run the server at 2500 Hz, first silent, then asked a thousand times a second; a canary runs beside it.

    Args:
        commands: Requests that create the objects.
        seconds: How long each.
    """
    loads: list[float] = []
    with (
        Emulator(init_seconds=0.5, on_message=lambda message: _note(message, loads)) as emulator,
        emulator.connect_world() as world,
    ):
        link = connect_link(emulator.url)
        try:
            _bring_up(link.exchange, commands, None)
            world.exchange(_HAND)
            with Canary() as canary:
                first, first_canary = world.observe(), canary.missed
                loads.clear()
                time.sleep(seconds + 0.5)
                idle = median(loads[1:])
                loads.clear()
                _ask(link, seconds + 0.5)
                asked = median(loads[1:])
                last, last_canary = world.observe(), canary.missed
        finally:
            link.close()
    missed = last.missed - first.missed
    return Shares(
        100.0 * idle, 100.0 * asked, last.step - first.step + missed, missed, last_canary - first_canary
    )


def _bring_up(ask: Callable[[str], str], commands: list[str], lockstep: LockstepEmulator | None) -> None:
    """Initialise, go to state force and create the objects; stops at the first refusal."""
    ask("set state init")
    while not ask("get state").startswith("stop"):
        if lockstep is None:
            time.sleep(0.01)
        else:
            lockstep.advance_to_ns((lockstep.device.step + 250) * 400_000)
    for command in ("set state force", *commands):
        reply = ask(command)
        if "ERROR" in reply:
            raise SystemExit(f"{command}: {reply}")


def _ask(link: CommandLink, seconds: float) -> None:
    """One request a millisecond, on an absolute grid."""
    due = time.monotonic()
    end = due + seconds
    while due < end:
        link.exchange(CYCLE)
        due += 0.001
        time.sleep(max(0.0, due - time.monotonic()))


def _note(message: object, loads: list[float]) -> None:
    if isinstance(message, dict) and "status" in message:
        loads.append(message["status"]["load"])


app = App(name="emulator", help="Measure what the emulator costs.")


@app.default
def main(*, rounds: int = 11, device_seconds: float = 4.0, wall_seconds: int = 10) -> None:
    """Measure and print.

    Args:
        rounds: How often the ways to run the arm take turns.
        device_seconds: Device time of one turn [s].
        wall_seconds: How long the server is watched, silent and asked [s].
    """
    write("lock-step: device time over processor time")
    write(f"{'objects':<28}{'steps':>9}{'1 ms':>9}{'cycles':>9}{'plain':>9}{'ratio':>9}")
    for name, commands in OBJECTS.items():
        speeds = measure_speeds(commands, rounds=rounds, device_s=device_seconds)
        cycles = f"{speeds.cycles:.0f}x" if speeds.cycles else "-"
        row = [f"{speeds.steps:.0f}x", f"{speeds.milliseconds:.0f}x", cycles, f"{speeds.plain:.1f}x"]
        row.append(f"{speeds.steps / speeds.plain:.0f}")
        write(f"{name:<28}" + "".join(f"{cell:>9}" for cell in row))
    tell(f"server: {2 * wall_seconds} s on the wall clock")
    shares = measure_shares(OBJECTS["20 of all types"], seconds=wall_seconds)
    write("server at 2500 Hz, 20 enabled objects: processor time over wall time")
    write(f"{'silent':<28}{shares.idle:>8.1f} %")
    write(f"{'asked 1000 times a second':<28}{shares.asked:>8.1f} %")
    write(f"missed {shares.missed} of {shares.periods} periods, a canary beside it {shares.canary}")


if __name__ == "__main__":
    app()
