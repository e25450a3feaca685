"""The simulated demonstrator, made for a task: what he knows from practice, and what he sees of the plane."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from hm_driver.errors import ConfigurationError
from hm_driver.recording.reader import Recording
from teaching.hands.contract import Hand, HandIntent, Vector
from teaching.hands.learning import ClumsyHand, LearningHand, MistakenHand
from teaching.hands.recorded import RecordedHand
from teaching.hands.screen import Screen
from teaching.hands.simulated import DemonstratorOptions, Kind, SimulatedHand
from teaching.messages import HAND_STATE_CHANNEL
from teaching.task import Task

FIRST_GUESS = 0.03
"""Depth that a novice tries first [m]."""
HANDS: Final[Mapping[Kind, type[SimulatedHand]]] = {
    Kind.EXPERT: SimulatedHand,
    Kind.NOVICE: ClumsyHand,
    Kind.LEARNING: LearningHand,
    Kind.MISTAKEN: MistakenHand,
}
"""Who draws lines, by kind."""


def practised_depths(task: Task, error: float, rng: np.random.Generator) -> list[float]:
    """One depth for each colour, as learned by practising on it, with an error of its own.

    Args:
        task: The plane; its stiffness is what practice felt, and goes no further than this.
        error: Standard deviation of the depths, relative.
        rng: Randomness of the errors.

    Returns:
        Depths [m], in the order of the task's objects.
    """
    points = task.grid(40)
    colours = np.array([task.object_at(x, y) for x, y in points.tolist()])
    needed = task.reference_force / task.stiffness_at(points)
    depths = []
    for index in range(len(task.objects)):
        here = needed[colours == index]
        felt = float(np.mean(here)) if len(here) else FIRST_GUESS
        depths.append(felt * (1.0 + error * float(rng.standard_normal())))
    return depths


def build_demonstrator(
    task: Task, options: DemonstratorOptions, rng: np.random.Generator, *, handle: Vector
) -> Hand:
    """The demonstrator that the options name.

    Args:
        task: The plane; he is handed its colours, and depths only as practice gave them.
        options: Who he is, and his manner.
        rng: His randomness.
        handle: Where the handle is now [m].

    Raises:
        ConfigurationError: A recording has no hand.
        RecordingError: It cannot be read.
    """
    if options.kind is Kind.RECORDED:
        return read_hand(Path(options.recording))
    screen = Screen(task.object_at, 0.5 * task.size)
    if options.kind in (Kind.NOVICE, Kind.LEARNING):
        options = replace(options, practised=False)
    depths = [FIRST_GUESS]
    if options.practised:
        depths = practised_depths(task, options.practice_error, rng)
    elif options.kind is Kind.LEARNING:
        depths = [FIRST_GUESS] * len(task.objects)
    return HANDS[options.kind](
        areas=[screen.area(colour) for colour in screen.colours],
        screen=screen,
        depths=depths,
        reference_force=task.reference_force,
        to_handle=task.to_handle,
        surface_z=task.surface_z,
        start=task.to_manipulator(*handle),
        options=options,
        rng=rng,
    )


def read_hand(path: Path) -> RecordedHand:
    """The hand of a log, to do the same again.

    Raises:
        ConfigurationError: The log has no simulated hand, or did not log all of it.
        RecordingError: It cannot be read.
    """
    vectors = ("intended_position", "intended_velocity", "stiffness", "damping", "extra_force")
    names = [f"{vector}.{axis}" for vector in vectors for axis in "xyz"]
    with Recording(path) as log:
        if HAND_STATE_CHANNEL.topic not in log.topics:
            raise ConfigurationError("recording", f"{path} has no simulated hand; record one with hm teach")
        if not set(names) <= set(log.describe(HAND_STATE_CHANNEL.topic).columns):
            raise ConfigurationError(
                "recording",
                f"{path} is of an older version, whose logs lack the hand's damping; record it anew",
            )
        columns = log.columns(HAND_STATE_CHANNEL.topic, names=["time_ns", *names])
    stamps = np.asarray(columns["time_ns"], dtype=np.int64)
    times = (stamps - stamps[:1]) * 1e-9  # whole numbers first: they have more digits than a float
    rows = np.column_stack([np.asarray(columns[name], dtype=float) for name in names]).tolist()
    intents = [
        HandIntent(*((row[k], row[k + 1], row[k + 2]) for k in range(0, 15, 3))) if any(row[6:12]) else None
        for row in rows
    ]
    return RecordedHand(times.tolist(), intents)
