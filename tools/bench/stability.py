"""How stiff a wall or a hand may be before the emulated arm shakes: the Z-width, by bisection.

A hand presses the handle against a flat plane and the arm runs for four seconds. It is *stable* if in the
last half second the handle moves by less than `SWING_M`, or by less than a second before. Friction of the
joints may keep a stable hand moving by half of that; an unstable one shakes by tens of millimetres. All is
computed on the compiled model, with sensors without noise, so that the same numbers come out every time.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from emulator import layout
from emulator.arm_model import ArmModel
from emulator.effect_table import EffectKind
from emulator.parameters import ArmParameters

SOFTEST, STIFFEST = 1e3, 1e6
"""Range that is searched [N/m]; the device accepts walls of up to 200 kN/m."""
SWING_M = 2e-3
"""Movement of the handle, end to end, above which it shakes [m]."""

_PRESSING_N = 10.0
_GAP_M = 0.001
_DURATION_S = 4.0
_STEPS_A_SAMPLE = 3
_WINDOWS = 8
_DECAYS = 0.9
_RATIO = 2.0
_TOLERANCE = 1.03


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """A virtual mass, a hand that presses along z, and a wall under it."""

    mass: float
    """Virtual mass [kg]; the device refuses less than 2 kg."""
    hand_stiffness: float
    """[N/m]."""
    hand_damping: float = 20.0
    """[N·s/m]."""
    wall: float = 0.0
    """Stiffness of the wall [N/m]; 0: none."""
    damping_ratio: float = 0.0
    """Of the wall, on the virtual mass."""


def is_stable(parameters: ArmParameters, setting: Setting) -> bool:
    """Whether the handle comes to rest.

    Args:
        parameters: The arm.
        setting: What presses against what.
    """
    arm = _pressed_arm(parameters, setting)
    samples = round(_DURATION_S * parameters.rate_hz / _STEPS_A_SAMPLE)
    heights = np.empty(samples)
    for i in range(samples):
        arm.step(_STEPS_A_SAMPLE)
        heights[i] = arm.outputs[layout.O_TIP_POSITION + 2]
    window = samples // _WINDOWS
    last, earlier = np.ptp(heights[-window:]), np.ptp(heights[-3 * window : -2 * window])
    return bool(last < SWING_M or last < _DECAYS * earlier)


def stiffest(is_stable_at: Callable[[float], bool]) -> float:
    """Largest stiffness up to which everything is stable [N/m], within 3 %.

    Args:
        is_stable_at: Whether one stiffness is stable [N/m].

    Returns:
        0 where already `SOFTEST` is not stable, infinity where `STIFFEST` still is.
    """
    good, bad = 0.0, SOFTEST
    while is_stable_at(bad):
        if bad >= STIFFEST:
            return math.inf
        good, bad = bad, min(STIFFEST, bad * _RATIO)
    while good > 0.0 and bad > good * _TOLERANCE:
        middle = math.sqrt(good * bad)
        good, bad = (middle, bad) if is_stable_at(middle) else (good, middle)
    return good


def stiffest_wall(parameters: ArmParameters, setting: Setting) -> float:
    """Stiffest wall that a hand can press against [N/m]; 0 where it shakes already without."""
    if not is_stable(parameters, dataclasses.replace(setting, wall=0.0)):
        return 0.0
    return stiffest(lambda wall: is_stable(parameters, dataclasses.replace(setting, wall=wall)))


def stiffest_hand(parameters: ArmParameters, setting: Setting) -> float:
    """Stiffest hand that can hold the arm [N/m]."""
    return stiffest(
        lambda stiffness: is_stable(parameters, dataclasses.replace(setting, hand_stiffness=stiffness))
    )


def quiet(parameters: ArmParameters) -> ArmParameters:
    """The same arm with a force sensor without noise, resolution, offset and drift."""
    return dataclasses.replace(
        parameters, sensor_noise=0.0, sensor_resolution=1e-9, sensor_offset=0.0, sensor_drift=0.0
    )


def _pressed_arm(parameters: ArmParameters, setting: Setting) -> ArmModel:
    arm = ArmModel(parameters, seed=1)
    arm.inertia, arm.coulomb_friction = setting.mass, 0.0
    arm.place_at(0.0, 0.0, 0.0)
    arm.set_render(powered=True, effects=True, force_sensor=True)
    if setting.wall > 0.0:
        slot = arm.effects.allocate(EffectKind.FLAT_PLANE)
        arm.effects.set(slot, "pos", (0.0, 0.0, -_GAP_M))
        arm.effects.set(slot, "normal", (0.0, 0.0, 1.0))
        arm.effects.set(slot, "stiffness", setting.wall)
        arm.effects.set(slot, "dampfactor", setting.damping_ratio)
        arm.effects.set_enabled(slot, enabled=True)
    still = (0.0, 0.0, 0.0)
    target = (0.0, 0.0, -_GAP_M - _PRESSING_N / setting.hand_stiffness)
    arm.set_hand(target, still, (setting.hand_stiffness,) * 3, (setting.hand_damping,) * 3, still)
    return arm
