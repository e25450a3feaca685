"""Every check of the project in one command: ``python -m tools.checks``, from the top of a checkout.

Style, types, import contracts, tests with doctests, and the wheel. All run, whatever fails; the last lines
say which, and name every test that was skipped with its reason.
"""

import os
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from tools.cli.console import write

PACKAGES = ("hm_driver", "teaching", "emulator", "tools")
"""What the wheel holds."""

REAL_TIME_TESTS = (
    "tests/emulator/test_process.py",
    "tests/emulator/test_server.py",
    "tests/emulator/test_server_timing.py",
    "tests/emulator/test_world.py",
    "tests/examples",
    "tests/hm_driver/realtime",
    "tests/hm_driver/recording/test_recorder.py",
    "tests/timing",
    "tests/tools/doctor",
    "tests/tools/drive",
    "tests/tools/jitter",
    "tests/tools/test_bench_loop.py",
    "tests/tools/test_bench_safety.py",
    "tests/tools/test_cli.py",
    "tests/tools/test_run_hands.py",
)
"""Tests whose processes keep time: they run one at a time."""

_PYTHON = (sys.executable, "-m")
_TRY_AGAIN = ("--reruns", "2", "--reruns-delay", "3")
"""A host that stalls for a quarter of a second spoils any test of real time; what fails thrice is wrong."""
_DOCTESTS = ("--doctest-modules", "--doctest-glob=*.md")


class Check(NamedTuple):
    """One check and how to run it."""

    name: str
    """As the summary names it."""
    run: Callable[[Path], bool]
    """Given a scratch directory, writes what it finds to the terminal and returns whether all is well."""


class Skipped(NamedTuple):
    """A test that did not run."""

    test: str
    """Module and name of the test."""
    reason: str
    """Why not."""


def main() -> int:
    """Run all checks; 0 if every one passed, 1 if not, 2 if this is no checkout."""
    if not (Path("pyproject.toml").is_file() and Path("tests").is_dir()):
        write("python -m tools.checks: error: run it at the top of a checkout, where pyproject.toml is")
        return 2
    results = []
    with tempfile.TemporaryDirectory() as scratch:
        for check in checks():
            write(f"\n=== {check.name}")
            sys.stdout.flush()
            start = time.monotonic()
            is_well = check.run(Path(scratch))
            results.append((check.name, is_well, time.monotonic() - start))
        skipped = [one for junit in sorted(Path(scratch).glob("junit*.xml")) for one in skipped_tests(junit)]
    write("\n=== summary")
    write(f"{len(skipped)} skipped")
    for test, reason in skipped:
        write(f"  skipped {test}: {reason}")
    for name, is_well, duration_s in results:
        write(f"{'passed' if is_well else 'FAILED'}  {name}  ({duration_s:.0f} s)")
    return 0 if all(is_well for _, is_well, _ in results) else 1


def checks() -> list[Check]:
    """The checks, quick ones first."""
    return [
        Check("ruff check", _command("ruff", "check", ".")),
        Check("ruff format", _command("ruff", "format", "--check", ".")),
        Check("import contracts", _import_contracts),
        Check("mypy", _command("mypy")),
        Check("wheel", _wheel),
        Check("pytest with doctests", _tests),
    ]


def skipped_tests(junit: Path) -> list[Skipped]:
    """The tests that a JUnit file of pytest calls skipped; none where there is no file."""
    if not junit.is_file():
        return []
    found = []
    for case in ET.parse(junit).iter("testcase"):  # noqa: S314 - we wrote the file ourselves
        for note in case.iter("skipped"):
            name = f"{case.get('classname', '')}::{case.get('name', '')}".removeprefix("::")
            found.append(Skipped(name, note.get("message", "no reason given")))
    return found


def missing_from(wheel: Sequence[str], sources: Sequence[str]) -> list[str]:
    """Files of the packages that a wheel lacks, by the names inside it."""
    return sorted(set(sources) - set(wheel))


def _command(*words: str) -> Callable[[Path], bool]:
    return lambda _scratch: _succeeds(*_PYTHON, *words)


def _succeeds(*words: str) -> bool:
    return subprocess.run(words, check=False).returncode == 0


def _import_contracts(_scratch: Path) -> bool:
    return _succeeds(sys.executable, "-c", "from importlinter.cli import lint_imports_command as run; run()")


def _tests(scratch: Path) -> bool:
    """Run the tests in two lanes side by side, and print what each said when both have ended.

    What runs real-time processes has a lane of its own, where one test runs at a time; everything else stands
    back behind it, at the lowest priority.
    """
    beside = [f"--ignore={place}" for place in REAL_TIME_TESTS]
    lanes = {
        "real time": ["pytest", *REAL_TIME_TESTS, *_TRY_AGAIN],
        "all others": ["pytest", "tests", *PACKAGES, "docs", "README.md", *beside, *_DOCTESTS],
    }
    running = []
    for number, (lane, words) in enumerate(lanes.items()):
        output = (scratch / f"lane{number}.txt").open("w+b")
        command = [*_PYTHON, *words, f"--junitxml={scratch / f'junit{number}.xml'}"]
        command += ["-o", f"cache_dir={scratch / f'cache{number}'}"]
        before = _stand_back if number else None
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, preexec_fn=before)  # noqa: PLW1509 - it only lowers a priority
        running.append((lane, process, output))
    for lane, process, output in running:
        process.wait()
        output.seek(0)
        write(f"--- {lane}")
        write(output.read().decode(errors="replace"))
        output.close()
    return all(process.returncode == 0 for _, process, _ in running)


def _stand_back() -> None:
    if hasattr(os, "nice"):
        os.nice(19)


def _wheel(scratch: Path) -> bool:
    """Build the wheel, and look that no file of the packages was left out."""
    if not _succeeds(*_PYTHON, "build", "--wheel", "--outdir", str(scratch), "."):
        return False
    (wheel,) = scratch.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        lacking = missing_from(archive.namelist(), _sources())
    for name in lacking:
        write(f"{wheel.name} lacks {name}")
    return not lacking


def _sources() -> list[str]:
    files = (path for package in PACKAGES for path in Path(package).rglob("*") if path.is_file())
    return [path.as_posix() for path in files if "__pycache__" not in path.parts]


if __name__ == "__main__":
    sys.exit(main())
