"""The teaching session: what happens at each tick, 100 times a second.

Pure: it has no clock, no device and no file. A runner feeds it what the loop measured and carries its
set-point to the loop, on the wall clock or on a virtual one.
"""

from collections import deque
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import NamedTuple

from hm_driver.errors import ConfigurationError
from hm_driver.realtime.setpoint import LoopState, SetPoint
from teaching.accumulator import Accumulator, BackgroundUpdate, Batch
from teaching.arbitration import Arbitration, Query, blend
from teaching.evaluation import coverage
from teaching.hands.contract import Seen
from teaching.hands.paths import Area, Walker, raster
from teaching.lwr import LWR
from teaching.task import Task

INTENTION_S = 0.05
"""Time constant with which the hand's force enters the estimate of the intention [s]."""


class Stage(IntEnum):
    """The stages of a session, in order."""

    PRACTICE = 0
    """The human tries the task; nothing is accumulated."""
    TEACHING = 1
    """The human demonstrates; control is arbitrated."""
    AUTONOMOUS = 2
    """The human has let go; the skill performs the task over the whole plane."""
    DONE = 3
    """The autonomous run is over."""


class ForceFeedback(Enum):
    """How the demonstrator learns of the interaction force."""

    VISUAL = "visual"
    """On the screen: the reading of the paper taken here."""
    RENDERED = "rendered"
    """On the screen, and as a bias force on the hand."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOptions:
    """How a session goes."""

    practice: float = 4.0
    """Duration of practice before teaching: C = 1, nothing is accumulated [s]."""
    autonomy_coverage: float = 0.99
    """Share of the plane with a model, from which on the skill goes on alone; above 1: never by itself."""
    examination: float = 5.0
    """How long the demonstrator may examine the skill before the autonomous stage begins [s]."""
    give_up: float = 300.0
    """Duration after which teaching ends without having covered the plane [s]."""
    hand_over: float = 0.3
    """Least duration of a full change of control [s]. The blend zone of eq. (9) is 4 mm wide, 2 ticks at the
    speed of the demonstration; C follows eq. (9) no faster than this, and a hand-over takes its time."""
    samples_per_tick: int = 50
    """How many samples of an update are learned in a tick."""
    transient_speed: float = 0.05
    """Vertical speed of the handle above which no sample is accumulated [m/s]: on his way to a depth after a
    hand-over, a demonstrator does not demonstrate it. A large value takes every sample, as eq. (10) does."""
    record_without_contact: bool = False
    """Whether samples are accumulated while the manipulator does not touch the surface."""
    depth_limit: float = 0.2
    """Largest displacement that the skill may command [m]; the arm reaches 0.29 m for the paper's task."""
    autonomous_speed: float = 0.15
    """Speed of the manipulator in the autonomous run [m/s]."""
    autonomous_acceleration: float = 1.0
    """Acceleration of the manipulator in the autonomous run [m/s^2]."""
    autonomous_spacing: float = 0.02
    """Distance of the lines of the autonomous run [m]."""
    force_feedback: ForceFeedback = ForceFeedback.VISUAL
    """How the interaction force reaches the hand."""
    feedback_gain: float = 0.3
    """Share of the interaction force that is rendered on the hand."""

    def __post_init__(self) -> None:
        for name in ("practice", "examination", "hand_over", "feedback_gain"):
            if not 0.0 <= getattr(self, name):
                raise ConfigurationError(name, f"{getattr(self, name)} must not be negative")
        for name in (
            "give_up",
            "autonomous_speed",
            "autonomous_acceleration",
            "autonomous_spacing",
            "depth_limit",
            "transient_speed",
        ):
            if not 0.0 < getattr(self, name):
                raise ConfigurationError(name, f"{getattr(self, name)} must be above 0")
        if not 0.0 < self.autonomy_coverage:
            raise ConfigurationError("autonomy_coverage", f"{self.autonomy_coverage} must be above 0")
        if self.hand_over > 10.0:
            raise ConfigurationError("hand_over", f"{self.hand_over} s must be 0 to 10 s")
        if self.autonomous_spacing < 0.001:
            raise ConfigurationError(
                "autonomous_spacing", f"{self.autonomous_spacing} m must be at least 0.001 m"
            )
        if not 1 <= self.samples_per_tick <= 100_000:
            raise ConfigurationError("samples_per_tick", f"{self.samples_per_tick} must be 1 to 100000")


class Update(NamedTuple):
    """An update of the skill that was swapped in at this tick."""

    number: int
    """Counts from 1."""
    learner: LWR
    """The skill from now on; it is not changed in place."""
    coverage: float
    """Share of the plane that it covers."""


class Tick(NamedTuple):
    """What a tick decided and saw. Displacements are depths below the surface [m]."""

    stage: Stage
    C: float
    w_max: float
    x: float
    """Manipulator's position on the plane [m]."""
    y: float
    depth: float
    """Commanded displacement by the handle, z_r below z_a [m]."""
    y_demo: float
    """The demonstrator's command; an estimate of his intention where C < 1 [m]."""
    y_robot: float
    """The skill's command [m]."""
    y_cmd: float
    """The blend of eq. (8) [m]."""
    force: float
    """Interaction force of eq. (12) [N]."""
    stiffness: float
    """True stiffness at this place [N/m], for the analysis; no part of the session decides by it."""
    accumulated: int
    """Samples in the accumulation buffer."""
    recorded: bool
    """Whether this tick's sample was accumulated."""
    is_learning: bool
    """Whether an update is being learned aside."""
    set_point: SetPoint
    seen: Seen
    update: Update | None
    events: tuple[tuple[str, str], ...]
    """Name and text of what happened."""


class Session:
    """One session of teaching by demonstration with binary arbitration.

    Args:
        task: The plane, its objects and how the handle maps onto it.
        learner: The skill; a copy of it learns each update and replaces it in whole.
        arbitration: Who is in control.
        w_th: Activation from which on a place of the plane counts as covered.
        accumulator: Buffer of eqs. (10) and (11).
        assist_stiffness: Stiffness of the loop's assist spring [N/m], for the estimate of the intention.
        options: How the session goes.
    """

    def __init__(
        self,
        *,
        task: Task,
        learner: LWR,
        arbitration: Arbitration,
        w_th: float,
        accumulator: Accumulator,
        assist_stiffness: float,
        options: SessionOptions,
    ) -> None:
        self.task = task
        self.learner = learner
        self.options = options
        self.w_th = w_th
        self.stage = Stage.PRACTICE
        self.coverage = 0.0
        self.updates = 0
        self.hand_overs = 0
        self._arbitration = arbitration
        self._accumulator = accumulator
        self._assist_compliance = task.scale[2] / assist_stiffness
        self._batches: deque[Batch] = deque()
        self._pending: BackgroundUpdate[LWR] | None = None
        self._walker: Walker | None = None
        self._push = 0.0
        self._time = 0.0
        self._covered_at: float | None = None
        self._C = 1.0
        self._last_y_cmd: float | None = None
        self._sequence = 0.0
        self._requested_autonomy = False

    def request_autonomy(self) -> None:
        """Let the skill go on alone from the next tick, as the user may decide at any time."""
        self._requested_autonomy = True

    def tick(self, measured: LoopState, dt: float) -> Tick:
        """Decide by what was measured.

        Args:
            measured: The loop's latest state.
            dt: Time since the last tick [s].

        Returns:
            The set-point for the loop, and what the log and the demonstrator get to know.
        """
        task = self.task
        self._time += dt
        events = self._advance_stage()
        x, y, z = task.to_manipulator(measured.measured_x, measured.measured_y, measured.measured_z)
        contact = task.contact(x, y, z)
        depth = task.surface_z - z
        y_robot, w_max = self.learner.query(x, y)
        wanted = self._control_factor(y_robot, w_max)
        step = dt / self.options.hand_over if self.options.hand_over > 0.0 else 1.0
        C = min(self._C + step, max(self._C - step, wanted))
        if (C > 0.5) != (self._C > 0.5):
            self.hand_overs += 1
            events.append(("hand-over", "the human is in control" if C > 0.5 else "the skill is in control"))
        self._C = C
        self._push += dt / (dt + INTENTION_S) * (measured.force_z - self._push)
        y_demo = max(0.0, depth if C == 1.0 else depth - self._push * self._assist_compliance)
        y_robot = min(max(y_robot, 0.0), self.options.depth_limit)
        y_cmd = blend(C, y_demo, y_robot)
        recorded = self._accumulate(C, x, y, depth, measured.velocity_z)
        update = self._learn()
        if update is not None:
            events.append(("update", f"update {update.number}: coverage {100.0 * update.coverage:.1f} %"))
        return Tick(
            self.stage,
            C,
            w_max,
            x,
            y,
            depth,
            y_demo,
            y_robot,
            y_cmd,
            contact.force,
            contact.stiffness,
            self._accumulator.count,
            recorded,
            self._pending is not None,
            self._set_point(x, y, y_cmd, C, contact.force, dt),
            Seen(
                (measured.measured_x, measured.measured_y, measured.measured_z),
                x,
                y,
                depth,
                contact.force,
                C,
                task.object_at(x, y),
                self.stage >= Stage.AUTONOMOUS,
            ),
            update,
            tuple(events),
        )

    def _advance_stage(self) -> list[tuple[str, str]]:
        options = self.options
        before = self.stage
        if self.stage is Stage.PRACTICE and self._time > options.practice:
            self.stage = Stage.TEACHING
        if self.stage <= Stage.TEACHING:
            is_covered = self._covered_at is not None and self._time - self._covered_at >= options.examination
            if is_covered or self._requested_autonomy or self._time > options.practice + options.give_up:
                self.stage = Stage.AUTONOMOUS
        elif self.stage is Stage.AUTONOMOUS and self._walker is not None and self._walker.is_done:
            self.stage = Stage.DONE
        return (
            [("stage", self.stage.name.lower())] if self.stage is not before or self._sequence == 0.0 else []
        )

    def _control_factor(self, y_robot: float, w_max: float) -> float:
        if self.stage is Stage.PRACTICE:
            return 1.0
        if self.stage is Stage.TEACHING:
            return self._arbitration.factor(Query(y_robot, w_max))
        return 0.0

    def _accumulate(self, C: float, x: float, y: float, depth: float, velocity: float) -> bool:
        if self.stage is not Stage.TEACHING or C != 1.0:
            return False
        if abs(velocity) > self.options.transient_speed:
            return False
        if self.task.object_at(x, y) < 0 or not (self.options.record_without_contact or depth > 0.0):
            return False
        batch = self._accumulator.add((x, y), max(0.0, depth), C)
        if batch is not None:
            self._batches.append(batch)
        return True

    def _learn(self) -> Update | None:
        """Learn a share of the pending update; a finished one replaces the skill in whole."""
        if self._pending is None:
            if not self._batches:
                return None
            batch = self._batches.popleft()
            self._pending = BackgroundUpdate(self.learner.copy(), *batch, self.options.samples_per_tick)
        learned = self._pending.step()
        if learned is None:
            return None
        self._pending = None
        self.learner = learned
        self.updates += 1
        self.coverage = coverage(learned, self.task, self.w_th)
        if self._covered_at is None and self.coverage >= self.options.autonomy_coverage:
            self._covered_at = self._time
        return Update(self.updates, learned, self.coverage)

    def _set_point(self, x: float, y: float, y_cmd: float, C: float, force: float, dt: float) -> SetPoint:
        task, options = self.task, self.options
        self._sequence += 1.0
        assist = 1.0 if C == 1.0 and self.stage <= Stage.TEACHING else 0.0
        engage_z = 1.0 if C < 1.0 and self.stage is not Stage.DONE else 0.0
        rendered = options.force_feedback is ForceFeedback.RENDERED and self.stage <= Stage.TEACHING
        bias_z = options.feedback_gain * force if rendered else 0.0
        slope = 0.0 if self._last_y_cmd is None else (y_cmd - self._last_y_cmd) / dt
        self._last_y_cmd = y_cmd if engage_z else None
        target_x, target_y = x, y
        velocity_x = velocity_y = engage_xy = 0.0
        if self.stage is Stage.AUTONOMOUS:
            if self._walker is None:
                self._walker = self._autonomous_path(x, y)
            target_x, target_y = self._walker.step(dt)
            velocity_x, velocity_y = self._walker.velocity
            engage_xy = 1.0
        hx, hy, hz = task.to_handle(target_x, target_y, task.surface_z - y_cmd)
        return SetPoint(
            self._sequence,
            assist,
            engage_xy,
            engage_xy,
            engage_z,
            hx,
            hy,
            hz,
            velocity_x / task.scale[0],
            velocity_y / task.scale[1],
            -slope / task.scale[2],
            0.0,
            0.0,
            bias_z,
        )

    def _autonomous_path(self, x: float, y: float) -> Walker:
        options = self.options
        walker = Walker((x, y), options.autonomous_speed, options.autonomous_acceleration)
        half = 0.5 * self.task.size
        plane = Area(-half, half, -half, half)
        walker.go(raster(plane, options.autonomous_spacing, options.autonomous_spacing / 2.0, start=(x, y)))
        return walker
