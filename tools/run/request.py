"""What is asked of a session, and what came of it."""

from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from hm_driver.realtime.histogram import Percentiles
from teaching.task import Task
from tools.run.options import TeachOptions


class HandKind(Enum):
    """Who holds the end effector."""

    SIMULATED = "simulated"
    """The simulated demonstrator, through the emulator's world endpoint."""
    PERSON = "person"
    """A person at the handle of a real device."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TeachRequest:
    """One session to run."""

    options: TeachOptions
    """The merged configuration."""
    task: Task
    """The loaded task."""
    seed: int
    """Seed of everything random."""
    output: Path
    """Directory of log and report."""
    hand: HandKind = HandKind.SIMULATED
    device: str | None = None
    """Address of the device; None starts an emulator."""
    world: str | None = None
    """Address of the world endpoint of an emulator that runs elsewhere."""

    def streams(self) -> tuple[np.random.Generator, np.random.Generator, int]:
        """Independent randomness of the shuffling and of the demonstrator, and the emulator's seed."""
        shuffle, hand, emulator = np.random.SeedSequence(self.seed).spawn(3)
        return (
            np.random.default_rng(shuffle),
            np.random.default_rng(hand),
            int(emulator.generate_state(1)[0]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class TickTiming:
    """How punctual the session's own 100 Hz ticks were."""

    lateness: Percentiles
    """Wake-up behind the grid [us]."""
    excess_max_us: float | None
    """Largest lateness beyond that of a canary on the same deadlines [us]; None without a canary."""
    missed: int
    """Ticks skipped."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of a session."""

    log: Path
    """The log."""
    lost: int
    """Messages that did not get into it."""
    loop: dict[str, Any]
    """Statistics of the driver's loop; empty in lock-step."""
    ticks: TickTiming | None
    """Timing of the session's ticks; None in lock-step."""
