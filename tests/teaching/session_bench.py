"""A session on its own, fed with made-up states of the loop by a handle that goes where a test says."""

import numpy as np
import pytest

from hm_driver.realtime.setpoint import LoopState
from teaching.accumulator import Accumulator
from teaching.arbitration import ExistenceArbitration
from teaching.correction import CorrectionOptions
from teaching.lwr import LWR
from teaching.session import Session, SessionOptions, Stage

DT = 0.01
N_ACC = 100
ASSIST_STIFFNESS = 300.0
DEPTH = 0.05


class Teacher:
    """A session, and a handle that goes where the test says."""

    def __init__(
        self, task, *, n_acc=N_ACC, learner=None, arbitration=None, hindsight=0, correction=None, **options
    ):
        settings = {"practice": 0.0, "record_without_contact": True, **options}
        self.task = task
        self.session = Session(
            task=task,
            learner=learner or LWR(D=400.0, w_gen=0.8, w_prune=0.9),
            arbitration=arbitration or ExistenceArbitration(0.5, 0.05),
            w_th=0.5,
            accumulator=Accumulator(n_acc, hindsight=hindsight, rng=np.random.default_rng(3)),
            assist_stiffness=ASSIST_STIFFNESS,
            options=SessionOptions(**settings),
            correction=CorrectionOptions(**(correction or {})),
        )
        self.ticks = []

    def tick(self, x=0.05, y=0.05, depth=DEPTH, *, force_z=0.0, velocity_z=0.0, dt=DT):
        hx, hy, hz = self.task.to_handle(x, y, self.task.surface_z - depth)
        state = LoopState(measured_x=hx, measured_y=hy, measured_z=hz, force_z=force_z, velocity_z=velocity_z)
        self.ticks.append(self.session.tick(state, dt))
        return self.ticks[-1]

    def teach(self, seconds, **where):
        return [self.tick(**where) for _ in range(round(seconds / DT))]

    def teach_until_update(self, **where):
        for _ in range(10 * N_ACC):
            if (tick := self.tick(**where)).update is not None:
                return tick
        pytest.fail("there was no update")

    def run_alone(self, limit_s=200.0):
        """Follow the set-points as a perfect arm does, until the session is done."""
        tick = self.ticks[-1] if self.ticks else self.tick()
        for _ in range(round(limit_s / DT)):
            if tick.stage is Stage.DONE:
                return
            u = tick.set_point
            x, y, z = self.task.to_manipulator(u.target_x, u.target_y, u.target_z)
            if not u.engage_x:
                x, y = tick.x, tick.y
            tick = self.tick(x, y, self.task.surface_z - z)
        pytest.fail("the session was never done")

    def events(self, name):
        return [text for tick in self.ticks for found, text in tick.events if found == name]


def plane_learner(depth=DEPTH, *, hole=None):
    """A skill that knows one depth all over the plane, but for a hole of 7 cm about a place [m]."""
    learner = LWR(D=400.0, w_gen=0.8, w_prune=0.9)
    steps = np.arange(-0.2, 0.21, 0.02)
    X = np.array([(x, y) for x in steps for y in steps])
    if hole is not None:
        X = X[np.hypot(*(X - hole).T) > 0.07]
    return learner.partial_fit(X, np.full((len(X), 1), depth))
