"""The teaching session: what happens at each tick, 100 times a second.

Pure: it has no clock, no device and no file. A runner feeds it what the loop measured and carries its
set-point to the loop, on the wall clock or on a virtual one.
"""

import math
from collections import deque
from enum import IntEnum
from typing import Final, NamedTuple

from hm_driver.realtime.setpoint import LoopState, SetPoint
from teaching.accumulator import Accumulator
from teaching.arbitration import Arbitration, Observation, Query
from teaching.correction import CorrectionOptions, Insistence, Region
from teaching.hands.contract import Seen
from teaching.hands.paths import Area, Walker, raster
from teaching.learner import Learner
from teaching.session_options import Coupling, ForceFeedback, SessionOptions
from teaching.skill import Cause, Skill, Update
from teaching.task import Task

__all__ = ["Cause", "Coupling", "ForceFeedback", "Session", "SessionOptions", "Stage", "Tick", "Update"]

INTENTION_S: Final = 0.05
"""Time constant with which the hand's force enters the estimate of the intention [s]."""
TICK_S: Final = 0.01
"""Learning and arbitration run at 100 Hz, as in the paper."""
LONGEST_STEP_S: Final = 2.0 * TICK_S
"""What moves by itself does not catch up with what a stalled machine missed: it would have to jump [s]."""

SHALLOWEST: Final = 0.01
"""Depth that a transient is at least judged by [m]."""

Event = tuple[str, str]
"""Name and text of what happened."""


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


_PRACTICE, _TEACHING, _AUTONOMOUS, _DONE = Stage


class Tick(NamedTuple):
    """What a tick decided and saw. Displacements are depths below the surface [m]."""

    stage: Stage
    C: float
    w_max: float
    std: float
    """Standard deviation of the prediction [m]; 0 where the arbitration does not ask for it."""
    x: float
    """Manipulator's position on the plane [m]."""
    y: float
    depth: float
    """Displacement that commands the manipulator, z_r below z_a: the handle's where it is coupled [m]."""
    y_handle: float
    """The handle's [m]; negative above the surface."""
    y_demo: float
    """The demonstrator's command; an estimate of his intention where a spring holds the handle [m]."""
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
    """The change of the skill that came into force with this tick; of two the last."""
    events: tuple[Event, ...]


class Session:
    """One session of teaching by demonstration.

    Args:
        task: The plane, its objects and how the handle maps onto it.
        learner: The skill; a copy of it learns each update and replaces it in whole.
        arbitration: Who is in control.
        w_th: Activation from which on a place of the plane counts as covered.
        accumulator: Buffer of eqs. (10) and (11).
        assist_stiffness: Stiffness of the loop's assist spring [N/m], for the estimate of the intention.
        options: How the session goes.
        correction: How the human corrects the skill.
    """

    def __init__(
        self,
        *,
        task: Task,
        learner: Learner,
        arbitration: Arbitration,
        w_th: float,
        accumulator: Accumulator,
        assist_stiffness: float,
        options: SessionOptions,
        correction: CorrectionOptions | None = None,
    ) -> None:
        correction = correction or CorrectionOptions()
        self.task = task
        self.options = options
        self.w_th = w_th
        self.stage = Stage.PRACTICE
        self.hand_overs = 0
        self.is_pressed = False
        """Whether the human holds his button; whoever sees it sets it."""
        self.is_latched = False
        """Whether the button stays down without a finger on it, as that of a keyboard does."""
        self._arbitration = arbitration
        self._accumulator = accumulator
        self._skill = Skill(
            learner,
            task,
            arbitration,
            w_th=w_th,
            samples_per_tick=options.samples_per_tick,
            undo_steps=correction.undo_steps,
        )
        self._correction = correction
        self._insistence = Insistence(correction)
        self._assist_compliance = task.scale[2] / assist_stiffness
        self._needs_std = arbitration.needs_std
        self._observes = arbitration.is_stateful
        self._least_C = 0.0 if arbitration.is_gradual else math.nextafter(1.0, 0.0)
        """Samples are taken above this."""
        self._is_uncoupled = options.coupling is Coupling.UNCOUPLED
        self._is_rendered = options.force_feedback is ForceFeedback.RENDERED
        self._surface_z, self._scale_z = task.surface_z, task.scale[2]
        self._depth_limit, self._hand_over_s = options.depth_limit, options.hand_over
        self._walker: Walker | None = None
        self._due = 0.0
        self._push = 0.0
        self._time = 0.0
        self._mastered_at: float | None = None
        self._C = 1.0
        self._y_robot = 0.0
        self._kept = self._fade = 0.0
        self._held = 0.0
        self._settling = 0.0
        self._was_down = False
        self._has_insisted = False
        self._last_y_cmd: float | None = None
        self._sequence = 0.0
        self._requested_autonomy = False
        self._asked: deque[tuple[str, Region | None]] = deque()

    @property
    def learner(self) -> Learner:
        """The skill in use."""
        return self._skill.learner

    @property
    def coverage(self) -> float:
        """Share of the plane that it covers."""
        return self._skill.coverage

    @property
    def updates(self) -> int:
        """Batches learned."""
        return self._skill.updates

    @property
    def button(self) -> bool:
        """Whether the button counts as down: held, latched, or by insisting until the next update."""
        return self.is_pressed or self.is_latched or self._has_insisted

    def request_autonomy(self) -> None:
        """Let the skill go on alone from the next tick, as the user may decide at any time."""
        self._requested_autonomy = True

    def forget(self, region: Region | None = None) -> None:
        """Remove the models of a region with the next tick, and what was demonstrated there.

        Args:
            region: What to forget; None for the place where the manipulator is then.
        """
        self._asked.append(("forget", region))

    def forget_all(self) -> None:
        """Remove every model with the next tick, and all that was demonstrated."""
        self._asked.append(("forget all", None))

    def undo(self) -> None:
        """Take the last change of the skill back with the next tick: an update, or what was forgotten."""
        self._asked.append(("undo", None))

    def discard(self) -> None:
        """Throw away with the next tick what was demonstrated and is not yet being learned."""
        self._asked.append(("discard", None))

    def tick(self, measured: LoopState, dt: float) -> Tick:
        """Decide by what was measured.

        Args:
            measured: The loop's latest state.
            dt: Time since the last tick [s].

        Returns:
            The set-point for the loop, and what the log and the demonstrator get to know.
        """
        task, skill = self.task, self._skill
        self._time += dt
        step = dt if dt < LONGEST_STEP_S else LONGEST_STEP_S  # noqa: FURB136  # a call costs more
        is_steady = self._time < self._due and not self._requested_autonomy
        events = [] if is_steady else self._advance_stage()
        stage = self.stage
        is_teaching = stage is _TEACHING
        handle = measured.measured_x, measured.measured_y, measured.measured_z
        x, y, z = task.to_manipulator(*handle)
        y_handle = self._surface_z - z
        change = self._correct(x, y, events) if self._asked else None
        std = 0.0
        if self._needs_std:
            y_robot, w_max, std = skill.learner.query_std(x, y)
        else:
            y_robot, w_max = skill.learner.query(x, y)
        if is_teaching:
            wanted = self._arbitration.factor(Query(y_robot, w_max, std, x, y))
            if self._held > 0.0:
                self._held -= dt
                wanted = 1.0
        else:
            wanted = 1.0 if stage is _PRACTICE else 0.0
        if not 0.0 <= y_robot <= self._depth_limit:
            y_robot = min(max(y_robot, 0.0), self._depth_limit)
        C = before = self._C
        rate = step / self._hand_over_s if self._hand_over_s > 0.0 else 1.0
        if wanted != before:
            C = self._C = min(before + rate, max(before - rate, wanted))
            self._hand_over(before, C, events)
        push = self._push = self._push + dt / (dt + INTENTION_S) * (measured.force_z - self._push)
        is_led = stage <= _TEACHING
        is_free = C == 1.0 or (self._is_uncoupled and is_led)
        y_demo = y_handle if is_free else y_handle - push * self._assist_compliance
        if not y_demo > 0.0:
            y_demo = 0.0
        if self._fade > 0.0:
            y_robot = self._keep(y_robot, rate, before, C)
        self._y_robot = y_robot
        y_cmd = C * y_demo + (1.0 - C) * y_robot
        depth = C * y_handle + (1.0 - C) * y_robot if self._is_uncoupled else y_handle
        surface, force, stiffness = task.press(x, y, depth)
        recorded = False
        if is_teaching:
            is_fit = surface >= 0 and self._is_fit(y_handle, measured.velocity_z, dt)
            if is_fit and C > self._least_C:
                recorded = True
                batch = self._accumulator.add((x, y), y_demo)
                if batch is not None:
                    skill.learn(batch)
            if self._observes:
                self._observe(Observation(x, y, y_demo, y_robot, C, force, is_fit, self.button,
                                          skill.learner.n_models > 0, dt), events)  # fmt: skip
            if self._insistence.is_possible:
                self._feel(x, y, C, dt, events)
        update = skill.step()
        if update is not None:
            change = self._take_over(update, C, events)
        sequence = self._sequence = self._sequence + 1.0
        is_engaged = not is_free and stage is not _DONE
        slope = 0.0 if self._last_y_cmd is None else (y_cmd - self._last_y_cmd) / dt
        self._last_y_cmd = y_cmd if is_engaged else None
        target_x, target_y, target_z = task.to_handle(x, y, self._surface_z - y_cmd)
        velocity_x = velocity_y = engage_xy = 0.0
        if stage is _AUTONOMOUS:
            target_x, target_y, velocity_x, velocity_y = self._walk(x, y, step)
            engage_xy = 1.0
        return Tick(
            stage,
            C,
            w_max,
            std,
            x,
            y,
            depth,
            y_handle,
            y_demo,
            y_robot,
            y_cmd,
            force,
            stiffness,
            self._accumulator.count,
            recorded,
            skill.is_learning,
            SetPoint(
                sequence,
                1.0 if is_free and is_led else 0.0,
                engage_xy,
                engage_xy,
                1.0 if is_engaged else 0.0,
                target_x,
                target_y,
                target_z,
                velocity_x,
                velocity_y,
                -slope / self._scale_z,
                0.0,
                0.0,
                self.options.feedback_gain * force if self._is_rendered and is_led else 0.0,
            ),
            Seen(handle, x, y, depth, force, C, surface, not is_led, self._is_uncoupled),
            change,
            tuple(events) if events else (),
        )

    def _advance_stage(self) -> list[Event]:
        options = self.options
        before = self.stage
        if self.stage is _PRACTICE and self._time > options.practice:
            self.stage = _TEACHING
        if self.stage <= _TEACHING:
            mastered_at = self._mastered_at
            is_ready = mastered_at is not None and self._time - mastered_at >= options.examination
            if is_ready or self._requested_autonomy or self._time > options.practice + options.give_up:
                self.stage = _AUTONOMOUS
        elif self.stage is _AUTONOMOUS and self._walker is not None and self._walker.is_done:
            self.stage = _DONE
        self._due = self._next_due()
        if self.stage is before and self._sequence > 0.0:
            return []
        return [("stage", self.stage.name.lower())]

    def _next_due(self) -> float:
        """Time before which no stage ends but by the user's wish [s]; a moment early, for rounding."""
        options = self.options
        if self.stage is _AUTONOMOUS:
            return 0.0
        due = options.practice
        if self.stage is _TEACHING or self._time > due:
            due += options.give_up
        if self._mastered_at is not None:
            due = min(due, self._mastered_at + options.examination)
        return due - 0.5 * TICK_S

    def _hand_over(self, before: float, C: float, events: list[Event]) -> None:
        """Note that control changes; with the human's, a batch may end or a take-over begin."""
        if (C > 0.5) != (before > 0.5):
            self.hand_overs += 1
            events.append(("hand-over", "the human is in control" if C > 0.5 else "the skill is in control"))
        least = self._least_C
        if C > least >= before:
            self._settling = self.options.settling
            self._held = max(self._held, self.options.stay)
        elif before > least >= C:
            while (batch := self._accumulator.confirm()) is not None:
                self._skill.learn(batch)
            if self.options.flush and (batch := self._accumulator.flush(self.options.flush)) is not None:
                self._skill.learn(batch)

    def _is_fit(self, y_handle: float, velocity: float, dt: float) -> bool:
        """Whether what the handle does is a demonstration: in contact, and no way to somewhere else."""
        options = self.options
        rate = options.transient_rate
        limit = options.transient_speed
        if rate > 0.0:
            limit = min(limit, rate * max(y_handle, SHALLOWEST))
        if abs(velocity) > limit:
            self._accumulator.retract()
            return False
        if self._settling > 0.0:
            self._settling -= dt
            return False
        return options.record_without_contact or y_handle > 0.0

    def _observe(self, observation: Observation, events: list[Event]) -> None:
        if observation.is_pressed is not self._was_down:
            self._was_down = observation.is_pressed
            events.append(("button", f"the human's button is {'down' if self._was_down else 'up'}"))
        self._arbitration.observe(observation)

    def _feel(self, x: float, y: float, C: float, dt: float, events: list[Event]) -> None:
        """Give control back to a human who insists, and forget what he insists against."""
        is_robot = C < 0.5 and not self._is_uncoupled
        if self._insistence.step(self._push, dt, is_robot=is_robot):
            events.append(("insist", f"the human pushed against the skill with {abs(self._push):.1f} N"))
            self._asked.append(("forget", Region(x, y, self._correction.radius)))
            self._has_insisted = True

    def _correct(self, x: float, y: float, events: list[Event]) -> Update | None:
        """Do what the human asked for, in the order in which he did."""
        change = None
        while self._asked:
            kind, region = self._asked.popleft()
            if self.stage > _TEACHING:
                events.append((kind, "not in the autonomous run: nothing was changed"))
            elif kind == "undo":
                undone = self._skill.undo()
                if undone is None:
                    events.append((kind, "there is nothing to undo"))
                else:
                    events.append((kind, f"undid {undone[1]}: coverage {100.0 * undone[0].coverage:.1f} %"))
                    change = self._take_over(undone[0], self._C, events)
            elif kind == "discard":
                discarded = self._accumulator.discard(lambda _: True)
                events.append((kind, f"{discarded} samples were thrown away"))
            else:
                if kind == "forget":
                    region = region or Region(x, y, self._correction.radius)
                forgotten = self._forget(region, kind, x, y, events)
                change = forgotten or change
        return change

    def _forget(
        self, region: Region | None, kind: str, x: float, y: float, events: list[Event]
    ) -> Update | None:
        if region is None:
            place = "everywhere"
            self._arbitration.reset()
            dropped = self._accumulator.discard(lambda _: True)
        else:
            place = f"about x = {region.x:.3f} m, y = {region.y:.3f} m"
            self._arbitration.forget(*region)
            dropped = self._accumulator.discard(lambda at: region.contains(at[0], at[1]))
        if region is None or region.contains(x, y):
            self._held = max(self._held, self._correction.hold)
        change, removed = self._skill.forget(region)
        text = f"{removed} models and {dropped} samples {place}: coverage {100.0 * self.coverage:.1f} %"
        events.append((kind, text))
        return None if change is None else self._take_over(change, self._C, events)

    def _take_over(self, update: Update, C: float, events: list[Event]) -> Update:
        """Go on with another skill, from the command of the one before."""
        if C < 1.0:
            self._kept, self._fade = self._y_robot, 1.0
        if update.cause is Cause.UPDATE:
            events.append(("update", f"update {update.number}: coverage {100.0 * update.coverage:.1f} %"))
            self._has_insisted = False
        if update.cause is Cause.FORGET or self._skill.mastery < self.options.autonomy_coverage:
            self._mastered_at = None  # what is forgotten is to be taught anew, however small it is
        elif self._mastered_at is None:
            self._mastered_at = self._time
        self._due = self._next_due()
        return update

    def _keep(self, y_robot: float, rate: float, before: float, C: float) -> float:
        """The skill's command, faded in from the one before, which stays while control leaves the skill."""
        if C <= before:
            self._fade = max(0.0, self._fade - rate)
        if C == 1.0:
            self._fade = 0.0
        return self._fade * self._kept + (1.0 - self._fade) * y_robot

    def _walk(self, x: float, y: float, dt: float) -> tuple[float, float, float, float]:
        """Position [m] and velocity [m/s] of the handle along the autonomous run's path."""
        if self._walker is None:
            self._walker = self._autonomous_path(x, y)
        x, y = self._walker.step(dt)
        velocity_x, velocity_y = self._walker.velocity
        target_x, target_y, _ = self.task.to_handle(x, y, 0.0)
        return target_x, target_y, velocity_x / self.task.scale[0], velocity_y / self.task.scale[1]

    def _autonomous_path(self, x: float, y: float) -> Walker:
        options = self.options
        walker = Walker((x, y), options.autonomous_speed, options.autonomous_acceleration)
        half = 0.5 * self.task.size
        plane = Area(-half, half, -half, half)
        walker.go(raster(plane, options.autonomous_spacing, options.autonomous_spacing / 2.0, start=(x, y)))
        return walker
