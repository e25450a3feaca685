"""``hm emulate``: be a HapticMASTER on a TCP port."""

import sys
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from tools.cli.console import tell, write
from tools.cli.failures import ExitCode

if TYPE_CHECKING:
    from emulator.canary import Canary

_NO_NEGATIVE = Parameter(negative="")


def emulate(
    *,
    listen: str = "tcp://127.0.0.1:7654",
    world: str = "tcp://127.0.0.1:0",
    config: Path | None = None,
    seed: int = 0,
    speed: float = 1.0,
    init_seconds: float = 3.0,
    on_client_lost: Literal["continue", "stop"] = "continue",
    fault: Annotated[tuple[str, ...], _NO_NEGATIVE] = (),
    faults: Path | None = None,
    log: Path | None = None,
    canary: Annotated[bool, _NO_NEGATIVE] = False,
    lockstep: Annotated[bool, _NO_NEGATIVE] = False,
    quiet: Annotated[bool, _NO_NEGATIVE] = False,
) -> int:
    """Be a HapticMASTER: programs that talk to the robot can talk to this instead.

    The first line on standard output is the address of the device, the second that of the world endpoint,
    where a hand takes hold of the arm. A status line goes to standard error every second. Ctrl-C ends it.

    Args:
        listen: Address for the device's clients; port 0 for a free one. Anything but loopback is open to
            the network, without a password, as the robot is.
        world: Address for the hand; port 0 for a free one.
        config: TOML file with constants of the arm, in the form of emulator/arm.toml; it may hold any part.
        seed: Seed of the sensors' noise and of random faults.
        speed: Device seconds a wall second, 0.001 to 100.
        init_seconds: Time that state init takes [s].
        on_client_lost: What the arm does when a client that commanded is gone.
        fault: A fault, KIND[=VALUE][@START][+DURATION]: the device time at which it begins [s], at once if
            left out, and how long it lasts [s], to the end if left out; reply_delay=0.02@5+1 delays replies
            by 20 ms from 5 s to 6 s. May be given again. docs/emulator.md lists the kinds.
        faults: TOML file with a schedule of faults, see docs/emulator.md.
        log: File for the conversation, one JSON object a line.
        canary: Run a process beside the emulator that only sleeps from period to period, and tell in the
            status line how many periods it missed: those are the machine's. Takes a share of a core.
        lockstep: Let time pass only on request of the world endpoint.
        quiet: No status lines.
    """
    from emulator.canary import Canary
    from emulator.process import Emulator, EmulatorOptions

    options = EmulatorOptions(
        listen=listen,
        world=world,
        config=config,
        seed=seed,
        speed=speed,
        init_seconds=init_seconds,
        on_client_lost=on_client_lost,
        fault=fault,
        faults=faults,
        log=log,
        lockstep=lockstep,
    )
    tell("starting; the first start compiles the arm's model, which takes up to half a minute")
    beside = Canary() if canary else None

    def tell_status(message: Mapping[str, Any]) -> None:
        if "status" in message:
            _tell_status(message["status"], beside)

    try:
        with (
            Emulator(options, on_message=None if quiet else tell_status) as emulator,
            beside or nullcontext(),
        ):
            write(emulator.url)
            write(emulator.world_url)
            sys.stdout.flush()
            tell(f"scheduling: {emulator.scheduling}")
            emulator.wait()
            code = emulator.exit_code
    except KeyboardInterrupt:
        tell("ended")
        return ExitCode.INTERRUPTED
    if code:
        tell(f"the emulator's process ended with exit code {code}")
        return ExitCode.FAILED
    return ExitCode.OK


def _tell_status(status: Mapping[str, Any], canary: "Canary | None") -> None:
    clients = "1 client" if status["clients"] == 1 else f"{status['clients']} clients"
    missed = f"{status['missed']} missed periods"
    if canary is not None:
        missed += f" (canary {canary.missed})"
    line = (
        f"{status['time_s']:10.1f} s  {status['state']:8}  {clients}  {status['requests']} requests  "
        f"{status['refused']} refused  {missed}  load {100.0 * status['load']:.0f} %"
    )
    if sys.stderr.isatty():
        sys.stderr.write(f"\r{line}\x1b[K")
        sys.stderr.flush()
    else:
        tell(line)
