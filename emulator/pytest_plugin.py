"""Pytest fixtures that start the emulated HapticMASTER; installed with the package, used by naming them.

::

    def test_my_program(hapticmaster):
        my_program.run(hapticmaster.url)

With ``pytest --device tcp://HOST[:7654]`` the fixture ``device_url`` names a robot instead of an emulator.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from emulator.in_process import LockstepEmulator
    from emulator.process import Emulator


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--device``."""
    parser.getgroup("hapticmaster").addoption(
        "--device",
        metavar="URL",
        default=None,
        help="address of a HapticMASTER to test against; an emulator is started without it",
    )


@pytest.fixture
def start_emulator() -> Iterator[Callable[..., "Emulator"]]:
    """A function that starts emulators, options as `emulator.EmulatorOptions`; they end with the test."""
    from emulator.process import Emulator

    with ExitStack() as stack:

        def start(**options: Any) -> Emulator:  # noqa: ANN401 - checked by the options
            return stack.enter_context(Emulator(**({"init_seconds": 0.5} | options)))

        yield start


@pytest.fixture(scope="session")
def shared_hapticmaster() -> Iterator["Emulator"]:
    """An emulator in a process of its own for the whole session, in the state that the last test left."""
    from emulator.process import Emulator

    with Emulator(init_seconds=0.5) as emulator:
        yield emulator


@pytest.fixture
def hapticmaster(start_emulator: Callable[..., "Emulator"]) -> "Emulator":
    """A fresh emulator in a process of its own: its ``url`` for a client, its ``world_url`` for a hand."""
    return start_emulator()


@pytest.fixture
def lockstep_hapticmaster() -> "LockstepEmulator":
    """A fresh emulator in this process whose time passes when it is told to."""
    from emulator.in_process import LockstepEmulator

    return LockstepEmulator(init_seconds=0.5)


@pytest.fixture
def device_url(request: pytest.FixtureRequest) -> str:
    """Address of the device to test against: that of ``--device``, or of a fresh emulator."""
    given: str | None = request.config.getoption("--device")
    if given is not None:
        return given
    emulator: Emulator = request.getfixturevalue("hapticmaster")
    return emulator.url
