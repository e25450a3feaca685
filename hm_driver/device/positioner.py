"""Move the arm from point to point without the loop: a spring whose position is moved by the program.

::

    with hm_driver.connect("tcp://192.168.0.25") as arm:
        arm.initialise()
        with Positioner(arm) as positioner:
            positioner.move_to((0.05, 0.0, 0.1), speed=0.1)

In the device's state ``position``, which is the default, the arm follows the spring and does not answer to a
hand; in state ``force`` the hand can push it away, against at most the spring's largest force.
"""

import contextlib
import math
import time
from types import TracebackType
from typing import Self

from hm_driver.device.effects import Spring
from hm_driver.device.haptic_master import HapticMaster
from hm_driver.errors import ConfigurationError, HapticMasterError
from hm_driver.geometry import ArmGeometry
from hm_driver.protocol.commands import SetParameter
from hm_driver.protocol.vocabulary import State, Vector

SPEED_MAX = 0.3
"""Fastest that a reference may be moved [m/s]."""
_PEAK = 1.875
"""Largest speed of a minimum-jerk motion over its mean."""
_PERIOD_S = 0.01


class Positioner:
    """A spring at the end effector that is moved; a context manager whose end takes the spring away.

    It begins where the arm is, so that nothing jumps. When the program or the link is lost, the spring holds
    the arm where it was moved last.

    Args:
        arm: A device in state ``stop``, calibrated.
        state: `State.POSITION` or `State.FORCE`.
        name: Name of the spring.
        stiffness: Of the spring [N/m].
        damping_ratio: Of the spring, on the virtual mass.
        force_max: Largest force of the spring [N].

    Raises:
        ConfigurationError: Another state than these two.
    """

    def __init__(
        self,
        arm: HapticMaster,
        *,
        state: State = State.POSITION,
        name: str = "positioner",
        stiffness: float = 2000.0,
        damping_ratio: float = 1.0,
        force_max: float = 20.0,
    ) -> None:
        if state not in (State.POSITION, State.FORCE):
            raise ConfigurationError("state", f"{state.value!r} renders no spring; take position or force")
        self._arm = arm
        self._state = state
        self._name = name
        self._spring = Spring(stiffness=stiffness, dampfactor=damping_ratio, maxforce=force_max)
        self._reach: ArmGeometry | None = None
        self._reference: Vector = (0.0, 0.0, 0.0)

    @property
    def reference(self) -> Vector:
        """Where the spring pulls to [m]."""
        return self._reference

    def __enter__(self) -> Self:
        arm = self._arm
        self._reach = arm.workspace()
        arm.create(self._name, self._spring)
        arm.set_state(self._state)
        self._place(arm.measured_position(), (0.0, 0.0, 0.0))
        arm.enable(self._name)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(HapticMasterError) if error is not None else contextlib.nullcontext():
            self._arm.set_state(State.STOP)  # before the spring goes: nothing may move the arm meanwhile
            self._arm.remove(self._name)

    def move_to(self, target: Vector, *, speed: float = 0.1) -> None:
        """Move the spring to a point [m] in a straight line, and return when it is there.

        Args:
            target: End of the motion, in the device's frame [m].
            speed: Peak of a minimum-jerk motion [m/s], 0.3 m/s at most.

        Raises:
            ConfigurationError: The point is out of reach, or the speed out of range.
        """
        if not 0.0 < speed <= SPEED_MAX:
            raise ConfigurationError("speed", f"{speed} m/s must be above 0 and at most {SPEED_MAX:g} m/s")
        problem = None if self._reach is None else self._reach.violation(*target)
        if problem is not None or not all(map(math.isfinite, target)):
            raise ConfigurationError("target", f"{target} m is out of reach: {problem or 'not finite'}")
        start = self._reference
        distance = math.dist(start, target)
        duration_s = _PEAK * distance / speed
        began = time.monotonic()
        while (elapsed_s := time.monotonic() - began) < duration_s:
            share = elapsed_s / duration_s
            way = share * share * share * (10.0 + share * (6.0 * share - 15.0))
            rate = 30.0 * share * share * (1.0 - share) * (1.0 - share) / duration_s
            self._place(_between(start, target, way), _scaled(start, target, rate))
            time.sleep(_PERIOD_S)
        self._place(target, (0.0, 0.0, 0.0))

    def hold(self, duration_s: float) -> None:
        """Stay for a time [s], and ask for the state meanwhile, so that a lost link is noticed."""
        ends = time.monotonic() + duration_s
        while (remaining_s := ends - time.monotonic()) > 0.0:
            self._arm.link.ask("get state")
            time.sleep(min(0.1, remaining_s))

    def _place(self, position: Vector, velocity: Vector) -> None:
        settings = (("pos", position), ("vel", velocity))
        self._arm.link.exchange_many(
            [SetParameter(self._name, name, value).encode() for name, value in settings]
        )
        self._reference = position


def _between(start: Vector, end: Vector, share: float) -> Vector:
    (x, y, z), (to_x, to_y, to_z) = start, end
    return x + share * (to_x - x), y + share * (to_y - y), z + share * (to_z - z)


def _scaled(start: Vector, end: Vector, rate: float) -> Vector:
    (x, y, z), (to_x, to_y, to_z) = start, end
    return rate * (to_x - x), rate * (to_y - y), rate * (to_z - z)
