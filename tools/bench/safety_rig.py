"""An emulator that goes on when its client vanishes, an application with a loop, and clocks beside them.

What is measured is device time, by the emulator's own stamps: from the event, or from the first reply that
shows it, to the reply that acknowledges ``set state stop``. Canaries, one a CPU, tell what the machine itself
held up meanwhile.
"""

import base64
import contextlib
import json
import math
import os
import pickle
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import hm_driver
from emulator.process import Emulator
from emulator.world import Truth, WorldClient
from hm_driver.errors import HapticMasterError, LoopError
from hm_driver.protocol.vocabulary import ERROR_MARK, State
from hm_driver.realtime.canary import Canary, CanaryOptions
from hm_driver.realtime.options import LoopOptions
from hm_driver.realtime.process import LoopProcess
from hm_driver.realtime.scheduling import enter_realtime
from hm_driver.realtime.setpoint import SetPoint

_TICK_S = 0.01
_PRIORITY = 60
_START_S = 90.0
_STOP_S = 6.0
_CANARY_NS = 1_000_000
_HOME_M = 2e-3
_ONCE_S = 1.0
"""Time within which a second stop counts [s]: a loop that thaws later stops the device for itself."""
_LAG_S = 0.02
"""How far device time may lie behind the wall clock while a stall is caught up [s]."""
_MEASURED = re.compile(r"\[([^\]]*)\];\[([^\]]*)\];\[([^\]]*)\];(?:\w+;)?$")

Vectors = tuple[tuple[float, ...], ...]
"""Position [m], velocity [m/s] and force [N]."""


class Reply(NamedTuple):
    """One reply of the emulator."""

    time_s: float
    """Device time [s]."""
    request: str
    text: str

    def vectors(self) -> Vectors | None:
        """The measurements that it carries, if any."""
        found = _MEASURED.search(self.text)
        return found and tuple(tuple(map(float, part.split(","))) for part in found.groups())


class Stop(NamedTuple):
    """What came of an event."""

    latency_s: float
    """Device time from the event to the acknowledged stop [s]."""
    stall_s: float
    """What the canaries saw of the machine's own stalls meanwhile, all CPUs added [s]."""
    stops: int
    """Stops that the device took."""
    reason: str
    """The trip, as the application's exception names it; empty where it was killed."""
    detail: str
    """Its text."""

    @property
    def excess_s(self) -> float:
        """The latency beyond what the machine held up [s]."""
        return max(0.0, self.latency_s - self.stall_s)


class StarvedError(LoopError):
    """The machine kept loop or application from their work before the event, or lost a line of the log."""


class Application:
    """A process with a loop and a guardian, publishing set-points 100 times a second.

    Args:
        options: The loop's options.
        values: Fields of its set-points.
    """

    def __init__(self, options: LoopOptions, **values: float) -> None:
        argument = base64.b64encode(pickle.dumps((options, values))).decode()
        self._process = subprocess.Popen(  # our own interpreter and module
            [sys.executable, "-m", "tools.bench.safety_rig", argument],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        )  # fmt: skip
        first = self._read(_START_S)
        if "loop_pid" not in first:
            self.close()
            raise LoopError(f"the application did not start: {first.get('detail', 'it said nothing')}")
        self.loop_pid = int(first["loop_pid"])

    def kill(self, signal_number: int) -> None:
        """Send a signal to the application."""
        self._process.send_signal(signal_number)

    def kill_loop(self, signal_number: int) -> None:
        """Send a signal to the loop's process."""
        os.kill(self.loop_pid, signal_number)

    def outcome(self, timeout_s: float) -> dict[str, str]:
        """Reason and detail of the exception that ended it; empty texts where it does not say."""
        return {"reason": "", "detail": ""} | self._read(timeout_s)

    def close(self) -> None:
        """End it, stopped or not."""
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGCONT)
        with contextlib.suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        try:
            self._process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _read(self, timeout_s: float) -> dict[str, str]:
        stream = self._process.stdout
        if stream is None or not select.select([stream], [], [], timeout_s)[0]:
            return {}
        values: dict[str, str] = json.loads(stream.readline() or "{}")
        return values


class Rig:
    """The emulator, the hand's way to it, its log, and the canaries; a context manager.

    Args:
        directory: Where the emulator's log goes.
    """

    def __init__(self, directory: Path) -> None:
        self._log = directory / "conversation.jsonl"
        self._stack = contextlib.ExitStack()
        self._canaries: list[Canary] = []
        self._start_ns = time.monotonic_ns()
        self.url = ""
        self.pull = 0.0
        """Force along x with which the hand pulls besides [N]."""

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            emulator = stack.enter_context(Emulator(log=self._log, init_seconds=0.5, seed=1))
            self.url = emulator.url
            self.world = stack.enter_context(WorldClient(emulator.world_url))
            self._start_ns = time.monotonic_ns()
            for cpu in sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [None]:
                options = CanaryOptions(
                    period_ns=_CANARY_NS, start_ns=self._start_ns, length=1 << 16, priority=95, cpu=cpu
                )
                self._canaries.append(stack.enter_context(Canary(options)))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def park(self) -> None:
        """Bring the arm to its home pose, without faults, and stop it there."""
        self.world.clear_faults()
        self.pull = 0.0
        with hm_driver.connect(self.url) as arm:
            if not arm.is_position_calibrated():
                arm.initialise()
            arm.set_state(State.HOME)
            deadline = time.monotonic() + _STOP_S
            while math.dist(self.hold().position, (0.0, 0.0, 0.0)) > _HOME_M:
                if time.monotonic() > deadline:
                    raise LoopError(f"the arm did not get home within {_STOP_S:g} s")
                time.sleep(_TICK_S)

    def hold(self, z: float = 0.0, *, stiffness: float = 300.0, damping: float = 20.0) -> Truth:
        """Let a hand hold the arm at a height [m]."""
        nothing = [0.0, 0.0, 0.0]
        hand = {"position": [0.0, 0.0, z], "stiffness": [stiffness] * 3, "damping": [damping] * 3}
        return self.world.exchange({**hand, "velocity": nothing, "force": [self.pull, 0.0, 0.0]})

    def stop_after(
        self,
        application: Application,
        strike: Callable[["Rig", Application], float],
        *,
        shows: Callable[[Vectors], bool] | None = None,
        tells: bool = True,
    ) -> Stop:
        """Let an event strike and wait for the stop.

        Args:
            application: What runs the loop.
            strike: Causes the event; returns the device time just before it [s].
            shows: Tells from a measurement whether the event has happened, where that takes its time.
            tells: Whether the application can still tell what ended its loop.

        Raises:
            StarvedError: The arm had been stopped before, or was stopped at a time that is not known.
            LoopError: The device was not stopped within 6 s.
        """
        if self.world.observe().state != "force":
            raise StarvedError(f"stopped before the event: {application.outcome(1.0)['reason']}")
        place = self._log.stat().st_size
        began_ns = time.monotonic_ns()
        struck_s = event_s = strike(self, application)
        deadline = time.monotonic() + _STOP_S
        while not (stops := self._stops(place)):
            if time.monotonic() > deadline:
                if self.world.observe().state != "force":
                    raise StarvedError("the arm was stopped, and the emulator's log lost the line")
                told = application.outcome(0.0)["reason"] or "nothing"
                raise LoopError(f"the device was not stopped within {_STOP_S:g} s; told: {told}")
            time.sleep(0.01)
        ended_ns = began_ns + int((stops[0] - struck_s + _LAG_S) * 1e9)
        stalls_s = [self._stall_s(canary, began_ns, ended_ns) for canary in self._canaries]
        outcome = application.outcome(_STOP_S if tells else 0.0)
        application.close()
        if shows is not None:
            replies = self._replies(place)
            event_s = next((r.time_s for r in replies if (v := r.vectors()) and shows(v)), stops[0])
        acknowledged = [time_s for time_s in self._stops(place, is_taken=True) if time_s < stops[0] + _ONCE_S]
        return Stop(
            stops[0] - event_s, sum(stalls_s), len(acknowledged), outcome["reason"], outcome["detail"]
        )

    def _stops(self, place: int, *, is_taken: bool = False) -> list[float]:
        """When a stop was answered, or only when it was taken [s]."""
        return [
            reply.time_s
            for reply in self._replies(place)
            if reply.request == "set state stop" and not (is_taken and ERROR_MARK in reply.text)
        ]

    def _replies(self, place: int) -> Iterator[Reply]:
        request = ""
        with self._log.open(encoding="utf-8") as file:
            file.seek(place)
            for line in file:
                if line.endswith("\n"):
                    entry: dict[str, Any] = json.loads(line)
                    if entry["direction"] == "<":
                        yield Reply(entry["time_s"], request, entry["text"])
                    request = entry["text"]

    def _stall_s(self, canary: Canary, began_ns: int, ended_ns: int) -> float:
        first = (began_ns - self._start_ns) // _CANARY_NS
        last = (ended_ns - self._start_ns) // _CANARY_NS
        late = [point.lateness_ns for point in canary.points(first) if point.number <= last]
        return max(late, default=0) * 1e-9


def main() -> None:
    """Run the application that the parent describes in the first argument."""
    options, values = pickle.loads(base64.b64decode(sys.argv[1]))  # noqa: S301  # our own parent made it
    try:
        with LoopProcess(options) as loop:
            loop.start()
            enter_realtime(_PRIORITY, hold_dma_latency=False)  # as sessions do
            _say({"loop_pid": loop.pid})
            tick = 0
            while not select.select([0], [], [], 0.0)[0]:
                tick += 1
                loop.publish(SetPoint(sequence=float(tick), **values))
                loop.check()
                time.sleep(_TICK_S)
    except HapticMasterError as error:
        _say({"reason": getattr(error, "reason", type(error).__name__), "detail": str(error)})


def _say(values: dict[str, object]) -> None:
    sys.stdout.write(json.dumps(values) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
