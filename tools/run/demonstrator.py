"""The simulated demonstrator, made for a task: what he knows from practice, and what he sees of the plane."""

import numpy as np

from teaching.hands.contract import Vector
from teaching.hands.screen import Screen
from teaching.hands.simulated import DemonstratorOptions, SimulatedHand
from teaching.task import Task

FIRST_GUESS = 0.03
"""Depth that a novice tries first [m]."""


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
) -> SimulatedHand:
    """The demonstrator of the paper's experiment.

    Args:
        task: The plane; he is handed its coloured areas, and depths only as practice gave them.
        options: His manner.
        rng: His randomness.
        handle: Where the handle is now [m].
    """
    screen = Screen(task.object_at, 0.5 * task.size)
    return SimulatedHand(
        areas=[screen.area(colour) for colour in screen.colours],
        screen=screen,
        depths=practised_depths(task, options.practice_error, rng) if options.practised else [FIRST_GUESS],
        reference_force=task.reference_force,
        to_handle=task.to_handle,
        surface_z=task.surface_z,
        start=task.to_manipulator(*handle),
        options=options,
        rng=rng,
    )
