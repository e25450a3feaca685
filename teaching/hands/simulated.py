"""A simulated demonstrator: sees what a person sees and acts through the force sensor alone.

He teaches each object in turn along parallel lines and looks at what the skill does after each update. Then
he follows the edges of the colours, where a skill is most likely wrong, and mops up where he remembers having
been in control. In z he knows one depth for each colour from practice, changes to it after his reaction lag
and corrects by the force that he sees. He never reads a stiffness.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from hm_driver.errors import ConfigurationError
from teaching.hands.button import Finger
from teaching.hands.contract import HandIntent, Seen, Vector
from teaching.hands.memory import PlaneMemory
from teaching.hands.paths import Area, Point, Walker, raster
from teaching.hands.screen import Screen

AIR = 0.01
"""Height above the surface at which he moves before he has seen a colour [m]."""


QUICKNESS = 25.0
"""Bandwidth of his arm's motion in depth [rad/s]."""
EDGES = (0.005, 0.015)
"""Distances from the edge of a colour at which he follows it, in turn [m]."""
PLACES = 6
"""How many single places he visits between two rounds along the edges."""
PASSES = 3
"""How often he draws lines over an object before he goes on, whatever came of it."""
LOOK = 0.5
"""How long he looks at a place where control may have changed, before he believes it [s]."""


class Kind(Enum):
    """Who demonstrates."""

    EXPERT = "expert"
    """The paper's experienced demonstrator."""
    NOVICE = "novice"
    """Knows no depth, has the seen force alone, and is ``clumsiness`` times as unsteady and as slow."""
    LEARNING = "learning"
    """Begins as a novice and becomes an expert, with a time constant of ``learning_time``."""
    MISTAKEN = "mistaken"
    """An expert who holds a wrong force in a region, until he sees what the skill has made of it."""
    RECORDED = "recorded"
    """Does what the hand in the log ``recording`` did."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DemonstratorOptions:
    """How the simulated demonstrator moves, sees and errs. Lengths and speeds are the manipulator's."""

    kind: Kind = Kind.EXPERT
    """Who demonstrates: expert, novice, learning, mistaken or recorded."""
    clumsiness: float = 3.0
    """How many times as unsteady and as slow to react a novice is."""
    learning_time: float = 30.0
    """Time constant with which kind learning loses its clumsiness [s]."""
    mistake_share: float = 0.6
    """Share of the force that kind mistaken holds in his region."""
    mistake_x: float = -0.1
    """Middle of the region of his mistake [m]."""
    mistake_y: float = -0.1
    mistake_radius: float = 0.06
    """Its radius [m]."""
    recording: str = ""
    """Log of kind recorded."""
    speed: float = 0.18
    """Speed along the lines [m/s]."""
    line_spacing: float = 0.025
    """Distance of two lines [m]."""
    edge_distance: float = 0.02
    """How far from the edge of an object he keeps [m]."""
    examination: float = 3.0
    """How long he looks at the skill after an update [s]."""
    lag: float = 0.15
    """Reaction lag [s]."""
    force_noise: float = 0.5
    """Standard deviation of the force that he holds unsteadily [N]."""
    noise_time: float = 0.5
    """Correlation time of that noise [s]."""
    practised: bool = True
    """Whether he knows a depth for each colour; a novice has the seen force alone."""
    practice_error: float = 0.03
    """Standard deviation of the depths learned in practice, relative."""
    correction: float = 1.0
    """Share of the seen force error that he corrects in a second [1/s]."""
    stiffness: float = 1000.0
    """Of his arm while he is in control [N/m]."""
    damping: float = 70.0
    """Of his arm while he is in control [N*s/m]."""
    relaxed_stiffness: float = 15.0
    """Of his arm in z while the skill is in control [N/m]."""
    relaxed_damping: float = 2.0
    """Of his arm in z while the skill is in control [N*s/m]."""
    relax_time: float = 0.2
    """How long he takes to relax [s]."""
    grip_time: float = 0.1
    """How long he takes to take hold again [s]."""
    patience: float = 0.8
    """How long he waits with moving on until the depth is right [s]."""
    press_speed: float = 0.25
    """Speed at which he changes the depth on purpose [m/s]."""

    def __post_init__(self) -> None:
        times = ("noise_time", "relax_time", "grip_time")
        for name in (*times, "speed", "line_spacing", "stiffness", "press_speed"):
            if not getattr(self, name) > 0.0:
                raise ConfigurationError(name, f"{getattr(self, name)} must be above 0")
        for name in (
            "edge_distance",
            "examination",
            "lag",
            "force_noise",
            "practice_error",
            "correction",
            "damping",
            "relaxed_damping",
            "patience",
        ):
            if not getattr(self, name) >= 0.0:
                raise ConfigurationError(name, f"{getattr(self, name)} must not be negative")
        for name, low, high in (
            ("clumsiness", 1.0, 100.0),
            ("learning_time", 0.1, 1e4),
            ("mistake_share", 0.0, 3.0),
            ("mistake_x", -2.0, 2.0),
            ("mistake_y", -2.0, 2.0),
            ("mistake_radius", 0.005, 1.0),
        ):
            if not low <= getattr(self, name) <= high:
                raise ConfigurationError(name, f"{getattr(self, name)} must be {low:g} to {high:g}")
        if self.kind is Kind.RECORDED and not self.recording:
            raise ConfigurationError("recording", "name the log of which the hand is to be replayed")
        if self.line_spacing < 0.001:
            raise ConfigurationError("line_spacing", f"{self.line_spacing} m must be at least 0.001 m")
        if not 0.0 <= self.relaxed_stiffness <= 20.0:
            raise ConfigurationError("relaxed_stiffness", f"{self.relaxed_stiffness} N/m must be 0 to 20 N/m")


class Doing(Enum):
    """What the demonstrator is about."""

    APPROACHING = "approaching"
    """On his way to the object that is next."""
    TEACHING = "teaching"
    """Drawing lines over an object."""
    LOOKING_BACK = "looking back"
    """Seeing whether the skill has taken over where he was in control a moment ago."""
    EXAMINING = "examining"
    """Moving about where the skill has just taken over, to see how it does."""
    CORRECTING = "correcting"
    """Taking control back where the skill is wrong, and teaching that place anew."""
    MOPPING_UP = "mopping up"
    """Following the edges of the colours, and visiting places where he remembers having been in control."""


class SimulatedHand:
    """The demonstrator of the paper's experiment, simulated.

    Args:
        areas: The coloured areas on the screen, in the order in which he teaches them [m].
        depths: Depth [m] that he learned in practice for each colour; one first guess, of a novice.
        reference_force: What he is asked to hold [N].
        to_handle: Manipulator's x, y and height [m] to the handle's position [m].
        surface_z: Height of the surface in the manipulator's frame [m].
        start: Position of the handle now, in the manipulator's frame [m].
        options: His manner.
        rng: His randomness.
        screen: The colours as he sees them; without it the areas are all that he sees.
    """

    def __init__(
        self,
        *,
        areas: list[Area],
        depths: list[float],
        reference_force: float,
        to_handle: Callable[[float, float, float], Vector],
        surface_z: float,
        start: Vector,
        options: DemonstratorOptions,
        rng: np.random.Generator,
        screen: Screen | None = None,
    ) -> None:
        self._areas = areas
        self._screen = screen
        self._depths = list(depths)
        self._reference_force = reference_force
        self._to_handle = to_handle
        self._surface_z = surface_z
        self._options = options
        self._rng = rng
        self._noise = self._tremor = 0.0
        self._draws: list[float] = []
        self._walker = Walker((start[0], start[1]), options.speed)
        self._memory = PlaneMemory(areas, cell=options.line_spacing)
        self._object = 0
        self._lines_along_x = True
        self._path: list[Point] = []
        self._interrupted = Doing.TEACHING
        self._examined = 0.0
        self._looked = 0.0
        self._has_covered = False
        self._own_ticks = self._ticks = 0
        self._passes = 0
        self._rounds = 0
        self._visits = 0
        self._depth = surface_z - start[2]
        self._wanted = self._depth
        self._speed = 0.0
        self._hold = 1.0
        self._delayed: deque[tuple[float, int, float]] = deque()
        self._colour, self._felt = -1, 0.0
        self._settled = 0.0
        self._hesitates = False
        self._waited = 0.0
        self._age = 0.0
        self._taught: list[Point] = []
        self._last_position: Vector | None = None
        self._finger = Finger(reference_force)
        self.doing = Doing.APPROACHING
        self._start_object()

    @property
    def button(self) -> bool:
        """Whether he holds the button that takes control."""
        return self._finger.is_down

    def step(self, seen: Seen, dt: float) -> HandIntent | None:
        """Answer what is seen; lets go when the screen says that the autonomous stage begins."""
        self._finger.step(seen, dt)
        if seen.autonomous:
            return None
        options = self._options
        self._age += dt
        self._memory.see(seen.x, seen.y, seen.C, dt)
        self._decide(seen, dt)
        self._press(seen, dt)
        x, y = self._walker.step(dt, moving=not self._hesitates)
        in_control = seen.C > 0.5 or seen.is_free
        if in_control:
            self._hold = min(1.0, self._hold + dt / options.grip_time)
        else:
            self._hold = max(0.0, self._hold - dt / options.relax_time)
        stiffness_z = options.relaxed_stiffness + self._hold * (options.stiffness - options.relaxed_stiffness)
        damping_z = options.relaxed_damping + self._hold * (options.damping - options.relaxed_damping)
        position = self._to_handle(x, y, self._surface_z - self._depth)
        last = self._last_position or position
        self._last_position = position
        velocity = (
            (position[0] - last[0]) / dt,
            (position[1] - last[1]) / dt,
            (position[2] - last[2]) / dt,
        )
        return HandIntent(
            position,
            velocity,
            (options.stiffness, options.stiffness, stiffness_z),
            (options.damping, options.damping, damping_z),
        )

    def _clumsy(self) -> float:
        """How many times as unsteady and as slow to react he is now as his options say."""
        return 1.0

    def _aim(self, seen: Seen) -> float:  # noqa: ARG002  # for those who err
        """Share of the reference force that he takes for right at this place."""
        return 1.0

    def _start_object(self, shift: float = 0.0) -> None:
        """Draw lines along the border to what he taught before, so that control rarely changes hands."""
        spacing, margin = self._options.line_spacing, self._options.edge_distance + shift
        start, along_x = self._walker.position, self._lines_along_x
        if self._screen is None:
            path = raster(self._areas[self._object], spacing, margin, along_x=along_x, start=start)
        else:
            colour = self._screen.colours[self._object]
            path = self._screen.lines(colour, spacing, margin, along_x=along_x, start=start)
        self._walker.go(path)
        self._lines = len(path)
        self._own_ticks = self._ticks = 0
        self.doing = Doing.APPROACHING

    def _decide(self, seen: Seen, dt: float) -> None:
        """Choose where to go next by what the screen has shown so far."""
        memory, walker = self._memory, self._walker
        if self.doing is Doing.APPROACHING and walker.way_points_left < self._lines:
            self.doing = Doing.TEACHING
        if self.doing is Doing.EXAMINING:
            self._examined += dt
            if self._examined >= self._options.examination:
                self._go_on()
            elif walker.is_done:
                walker.go([self._taught[int(self._rng.integers(len(self._taught)))]])
        elif self.doing is Doing.LOOKING_BACK:
            self._looked = self._looked + dt if walker.is_done else 0.0
            if self._looked > LOOK and seen.C < 0.5:
                self._examine()
            elif seen.C == 1.0 or self._looked > LOOK:
                memory.dismiss()
                self.doing = self._interrupted
                walker.go(self._path)
        elif self.doing is Doing.MOPPING_UP:
            if walker.is_done:
                self._mop_up()
        elif memory.suspects and self.doing is not Doing.APPROACHING:
            self._interrupted, self.doing = self.doing, Doing.LOOKING_BACK
            self._path = [walker.position, *walker.way_points]
            self._looked = 0.0
            walker.go([memory.look_back()])
        elif walker.is_done:
            self._end_lines()
        if self.doing is Doing.TEACHING:
            self._ticks += 1
            self._own_ticks += seen.C > 0.5

    def _end_lines(self) -> None:
        """Draw lines between the lines, unless it is enough or the skill had control along most of these."""
        self._has_covered = True
        self._passes += 1
        if self._own_ticks < 0.5 * self._ticks or self._passes >= PASSES:
            self._next_object()
        else:
            self._start_object(shift=self._options.line_spacing / 2.0)

    def _examine(self) -> None:
        """See how the skill does where it has just taken over."""
        self._taught = self._memory.taught or [self._walker.position]
        self._memory.note_update()
        self._examined = 0.0
        self.doing = Doing.EXAMINING
        self._walker.go([])

    def _go_on(self) -> None:
        """Go on with the object until all of it has been taught once, then with the next."""
        if self._has_covered or len(self._path) < 2:
            self._next_object()
        else:
            self.doing = Doing.TEACHING
            self._walker.go(self._path)

    def _next_object(self) -> None:
        self._has_covered = False
        self._passes = 0
        self._object += 1
        if self._object < len(self._areas):
            before, area = self._areas[self._object - 1].centre, self._areas[self._object].centre
            self._lines_along_x = abs(area[1] - before[1]) > abs(area[0] - before[0])
            self._start_object()
        else:
            self.doing = Doing.MOPPING_UP
            self._mop_up()

    def _mop_up(self) -> None:
        """Follow the edges of the colours at each distance in turn, then look at single places."""
        if self._screen is not None and self._visits == 0 and self._rounds < len(EDGES):
            way: list[Point] = []
            for colour in reversed(self._screen.colours):
                way += self._screen.edge(
                    colour, EDGES[self._rounds], way[-1] if way else self._walker.position
                )
            self._rounds += 1
            if way:
                self._walker.go(way)
                return
        self._rounds = 0
        self._visits = (self._visits + 1) % PLACES
        self._walker.go([self._memory.next_place(*self._walker.position)])

    def _press(self, seen: Seen, dt: float) -> None:
        """Hold the depth of the colour seen a lag ago, corrected by the force seen a lag ago."""
        options = self._options
        clumsy, aim = self._clumsy(), self._aim(seen)
        self._delayed.append((self._age + clumsy * options.lag, seen.surface, seen.force))
        colour = self._colour
        while self._delayed and self._delayed[0][0] <= self._age + 1e-9:
            _, self._colour, self._felt = self._delayed.popleft()
        if seen.C <= 0.5 and not seen.is_free:
            self._move_depth(seen.depth, dt)
            self._settled = 0.0
            self._hesitates = False
            return
        decay = math.exp(-dt / options.noise_time)
        self._noise = decay * self._noise + math.sqrt(1.0 - decay * decay) * self._draw()
        self._tremor += dt / (dt + 1.0 / QUICKNESS) * (self._noise - self._tremor)
        if self._colour < 0:
            wanted = -AIR
        else:
            known = self._colour if len(self._depths) > 1 else 0
            near = abs(self._wanted - self._depth) < 0.1 * abs(self._wanted)
            self._settled = self._settled + dt if near and self._colour == colour else 0.0
            if self._settled > 2.0 * options.lag or not options.practised:
                error = aim - self._felt / self._reference_force
                self._depths[known] *= 1.0 + max(-0.5, min(0.5, error)) * options.correction * dt
            unsteady = clumsy * options.force_noise / self._reference_force * self._tremor
            wanted = self._depths[known] * (aim + unsteady)
        self._wanted = wanted
        off = abs(wanted - seen.depth) > 0.15 * abs(wanted)
        self._waited = self._waited + dt if off else 0.0
        self._hesitates = options.practised and off and self._waited < options.patience
        self._move_depth(wanted, dt)

    def _move_depth(self, wanted: float, dt: float) -> None:
        """Bring the intended depth to the wanted one as an arm does: without a step in speed."""
        pull = QUICKNESS * QUICKNESS * (wanted - self._depth) - 2.0 * QUICKNESS * self._speed
        speed = self._speed + pull * dt / (1.0 + QUICKNESS * dt) ** 2
        self._speed = max(-self._options.press_speed, min(self._options.press_speed, speed))
        self._depth += self._speed * dt

    def _draw(self) -> float:
        if not self._draws:
            self._draws = self._rng.standard_normal(1024).tolist()
        return self._draws.pop()
