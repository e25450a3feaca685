"""What reading a large log costs: ``python -m tools.bench.log --megabytes 1000``.

A log of a loop at 1 kHz is made in a temporary directory; then each command runs in a process of its own, of
which the wall time and the largest memory are printed. The file is in the page cache, as it was just written.
"""

import argparse
import json
import random
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hm_driver.recording.schemas import DEVICE_CHANNELS, LOOP_BUNDLE
from hm_driver.recording.writer import Attachment, Compression, LogWriter
from teaching.messages import ARBITRATION, ARBITRATION_CHANNEL

INFO_LIMIT_S = 1.0
SPEED_LIMIT_MB_S = 50.0
MEMORY_LIMIT_MB = 500.0
_EPOCH_NS = 1_800_000_000_000_000_000
_KINDS = 4096
"""Cycles with values of their own; they repeat, with new numbers and times."""
_NUMBERS = 22
"""Numbers of a cycle that are noise."""
_CONFIG = {"modes": {"inertia": 3.0, "position_stiffness": 5000.0, "position_damping_ratio": 1.0,
                     "position_force_max": 30.0, "assist_stiffness": 300.0, "assist_damping_ratio": 0.7,
                     "assist_force_max": 10.0}}  # fmt: skip
_READ = (
    "import sys, time, hm_driver.recording as r\n"
    "log = r.open(sys.argv[1]); t = time.perf_counter()\n"
    "n = len(log.columns('/device/state', names=['measured_force.z'])['measured_force.z'])\n"
    "print(n, time.perf_counter() - t)\n"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What a command took."""

    name: str
    wall_s: float
    """Wall time of the process [s]."""
    memory_mb: float
    """Largest resident memory [MB]."""
    output: str
    """What it printed."""


def make_log(path: Path, size_bytes: int, *, compression: Compression = Compression.ZSTD) -> None:
    """Write a log of a loop and its ticks until the file has a size.

    Args:
        path: The log.
        size_bytes: Its size, about [B].
        compression: How its chunks are compressed.
    """
    rng = random.Random(1)
    kinds = [[rng.gauss(0.0, 5.0) for _ in range(_NUMBERS)] for _ in range(_KINDS)]
    config = Attachment(name="config.json", media_type="application/json", data=json.dumps(_CONFIG).encode())
    with LogWriter(
        path, (*DEVICE_CHANNELS, ARBITRATION_CHANNEL), attachments=[config], compression=compression
    ) as writer:
        cycle = 0
        while writer.bytes_written < size_bytes:
            time_ns = _EPOCH_NS + cycle * 1_000_000
            payload = LOOP_BUNDLE.pack(*_cycle(kinds[cycle % _KINDS], cycle, time_ns))
            writer.chunk.add_bundle(LOOP_BUNDLE.slices, time_ns, payload)
            if cycle % 10 == 0:
                tick = (time_ns, 1, 0.5, 0.5, *(0.01,) * 10, 7, True, False, 0.0)
                writer.chunk.add(ARBITRATION_CHANNEL.id, time_ns, ARBITRATION.pack(*tick))
            writer.end_full_chunk()
            cycle += 1


def _cycle(values: Sequence[float], cycle: int, time_ns: int) -> list[float]:
    """Values of state, command and timing of a cycle; forces are noise, as a sensor's last digits are."""
    state = [cycle, time_ns, *(1e-3 * one for one in values[:6]), *values[6:9]]
    command = [cycle, time_ns, *(1e-3 * one for one in values[9:15]), *values[15:18], 1.0, 1.0, 1.0]
    command += [0.0, 0.0, 0.0, 0.0, 0.0]
    times = [int(1e4 * abs(one)) for one in values[18:22]]
    return [*state, *command, cycle, time_ns, *times, 0, 1e-3, 0]


_LAUNCH = """
import json, resource, subprocess, sys, time
began = time.perf_counter()
code = subprocess.run(sys.argv[2:]).returncode
wall_s = time.perf_counter() - began
with open(sys.argv[1], "w") as file:
    json.dump([code, wall_s, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss], file)
"""
"""Starts a command from a small process: the largest memory of a child counts its parent's at the start."""


def measure(name: str, words: Sequence[str]) -> Cost:
    """Run a command in a process of its own.

    Raises:
        RuntimeError: It failed.
    """
    with tempfile.NamedTemporaryFile("r") as told:
        launch = [sys.executable, "-S", "-c", _LAUNCH, told.name, *words]
        output = subprocess.run(launch, stdout=subprocess.PIPE, text=True, check=False).stdout
        code, wall_s, kilobytes = json.load(told)
    if code:
        raise RuntimeError(f"{name} failed with code {code}: {' '.join(words)}")
    return Cost(name=name, wall_s=wall_s, memory_mb=kilobytes / 1024.0, output=output)


def measure_all(log: Path, *, commands: Sequence[str] = ()) -> list[Cost]:
    """Cost of each command on a log.

    Args:
        log: The log.
        commands: Their names; all where there are none.
    """
    hm, directory = [sys.executable, "-m", "tools.cli.main", "log"], log.parent
    topic = ["--topic", "/device/state"]
    known = {
        "one signal": [sys.executable, "-c", _READ, str(log)],
        "info": [*hm, "info", str(log)],
        "check": [*hm, "check", str(log)],
        "plot": [*hm, "plot", str(log), "measured_force", "C", "--output", str(directory / "a.png")],
        "timing": [*hm, "timing", str(log)],
        "haptics": [*hm, "haptics", str(log)],
        "export .parquet": [*hm, "export", str(log), str(directory / "a.parquet"), *topic],
        "export .mat": [*hm, "export", str(log), str(directory / "a.mat"), *topic],
        "export .csv": [*hm, "export", str(log), str(directory / "a.csv"), *topic],
    }
    return [measure(name, words) for name, words in known.items() if not commands or name in commands]


def table(costs: Sequence[Cost], size_bytes: int) -> list[str]:
    """Lines of the table: time, speed over the file, and memory."""
    megabytes = size_bytes / 1e6
    lines = [f"log of {megabytes:.0f} MB", f"{'command':<16} {'wall s':>8} {'MB/s':>8} {'memory MB':>10}"]
    for cost in costs:
        speed = megabytes / cost.wall_s
        lines.append(f"{cost.name:<16} {cost.wall_s:>8.2f} {speed:>8.1f} {cost.memory_mb:>10.0f}")
    by_name = {cost.name: cost for cost in costs}
    if "one signal" in by_name:
        rows, seconds = by_name["one signal"].output.split()
        speed = megabytes / float(seconds)
        lines.append(
            f"one signal of {rows} messages without the start of Python: {speed:.1f} MB/s of file, "
            f"wanted at least {SPEED_LIMIT_MB_S:g}"
        )
    if "info" in by_name:
        lines.append(f"info: {by_name['info'].wall_s:.2f} s, wanted below {INFO_LIMIT_S:g} s")
    largest = max(cost.memory_mb for cost in costs)
    lines.append(f"largest memory: {largest:.0f} MB, wanted below {MEMORY_LIMIT_MB:g} MB")
    return lines


def main(words: Sequence[str] | None = None) -> None:
    """Make a log, run the commands on it, and print what they cost."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--megabytes", type=float, default=1000.0, help="size of the log")
    parser.add_argument(
        "--command", action="append", default=[], help="only this one; can be given several times"
    )
    options = parser.parse_args(words)
    with tempfile.TemporaryDirectory(prefix="hm-bench-log-") as directory:
        log = Path(directory) / "bench.mcap"
        make_log(log, round(options.megabytes * 1e6))
        costs = measure_all(log, commands=options.command)
        sys.stdout.write("\n".join(table(costs, log.stat().st_size)) + "\n")


if __name__ == "__main__":
    main()
