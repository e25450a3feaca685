"""Cycles of the loop and steps of the arm in one compiled call, without the wire between them.

Every value that the protocol would carry is rounded as its six digits do it, both ways, so that the result is
that of `tools.run.compiled_loop`, which writes and reads every line. Values go straight into the rows of the
device's objects, and come straight from what it can be asked. Whatever is unusual (an object to enable,
something on the device's agenda, a tripped limit, a value that the device would refuse) is left to Python
before anything of it has happened.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from emulator.compilation import entry_point, kernel, part
from emulator.grid import STEP_RATE_HZ
from emulator.in_process import Arm
from emulator.kernels import advance
from emulator.layout import (
    E_BIAS,
    E_MAX_FORCE,
    E_POSITION,
    E_VELOCITY,
    O_GUARD,
    O_MEASURED_FORCE,
    O_MEASURED_POSITION,
    O_MODEL_VELOCITY,
    S_HAND_AGE,
    S_HAND_GAIN,
    S_HAND_POSITION,
    S_HAND_RELEASED,
)
from emulator.number_text import round_wire
from hm_driver.protocol.numbers import SIGNIFICANT_DIGITS
from hm_driver.realtime.cycle import (
    ADMITTANCE,
    ASSIST,
    AXES,
    MEASUREMENT_SIZE,
    OK,
    P_BY_FORCE,
    PARAMETER_SIZE,
    PHASE,
    REFERENCE,
    S_FORCE,
    S_PUSH,
    S_SATURATED,
    SETPOINT_SIZE,
    SPRING_STRIDE,
    SPRINGS,
    STATE_SIZE,
    VELOCITY,
)
from hm_driver.realtime.setpoint import LoopState
from tools.run.client_kernels import cycle

# What a call returns.
DONE: Final = 0
ADVANCE: Final = 1
"""Python has to run the emulator up to the cycle's deadline."""
SWITCH: Final = 2
"""Python has to enable or disable springs, as `N_SWITCH` says."""
REFUSED: Final = 3
"""The hand is out of the world endpoint's range."""
UNUSUAL: Final = 4
"""The interpreted loop has to run this cycle."""

# Counts: integers that the kernel keeps.
N_CYCLES: Final = 0
"""Cycles run."""
N_IS_ADVANCED: Final = 1
"""1 where the emulator stands at the present cycle's deadline."""
N_STEP: Final = 2
"""Steps that the emulator has run."""
N_HAND: Final = 3
"""1 where there is a new intent of the hand, 2 where it lets go."""
N_PLACES: Final = 4
"""First of the places of the springs' rows, then of the bias force's, among the emulator's effects."""
N_ENABLED: Final = N_PLACES + SPRINGS + 1
"""First of the springs' switches: 1 where the device's spring is enabled."""
N_SIZE: Final = N_ENABLED + SPRINGS

# Numbers: everything else that Python and the kernel exchange.
HAND_SIZE: Final = 15
"""Position, velocity, stiffness, damping and force of the hand."""
F_SET_POINT: Final = 0
F_HAND: Final = F_SET_POINT + SETPOINT_SIZE
F_HAND_LOW: Final = F_HAND + HAND_SIZE
F_HAND_HIGH: Final = F_HAND_LOW + HAND_SIZE
F_SPRING_LIMIT: Final = F_HAND_HIGH + HAND_SIZE
"""Lowest and highest reference, velocity and cap of a spring."""
F_BIAS_LIMIT: Final = F_SPRING_LIMIT + 2 * PHASE
F_TOLD: Final = F_BIAS_LIMIT + 2
"""What the springs and, behind them, the bias force were told last, unrounded; NaN for nothing."""
F_LOOP_STATE: Final = F_TOLD + SPRINGS * SPRING_STRIDE + AXES
F_SIZE: Final = F_LOOP_STATE + len(LoopState._fields)


class Memory(NamedTuple):
    """The loop's memory."""

    s: npt.NDArray[np.float64]
    """State of the cycle function."""
    p: npt.NDArray[np.float64]
    """Its parameters."""
    u: npt.NDArray[np.float64]
    """The set-point: the first of `numbers`."""
    m: npt.NDArray[np.float64]
    """The measurement."""
    before: npt.NDArray[np.float64]
    """State and measurement before the present cycle."""
    numbers: npt.NDArray[np.float64]
    counts: npt.NDArray[np.int64]


def make_memory(parameters: Sequence[float]) -> Memory:
    """The memory of a loop before its first cycle.

    Args:
        parameters: Of the cycle function.
    """
    numbers = np.zeros(F_SIZE)
    numbers[F_TOLD : F_TOLD + SPRINGS * SPRING_STRIDE] = np.nan
    return Memory(
        s=np.zeros(STATE_SIZE),
        p=np.array(parameters).reshape(PARAMETER_SIZE),
        u=numbers[F_SET_POINT:F_HAND],
        m=np.zeros(MEASUREMENT_SIZE),
        before=np.zeros(STATE_SIZE + MEASUREMENT_SIZE),
        numbers=numbers,
        counts=np.zeros(N_SIZE, dtype=np.int64),
    )


_POWERS_OF_TEN = tuple(float(10**exponent) for exponent in range(23))
_LARGEST, _SMALLEST = 1e5, 1e-12
_LOG10_OF_2 = 0.30102999566398120
_FIRST_BEYOND = 10.0**SIGNIFICANT_DIGITS
_TIE = 1e-6
"""Far more than the rounding of a product of six digits, and far less than what is rare."""


@kernel
def round_quickly(x: float) -> float:
    """As `hm_driver.protocol.numbers.round_wire`, in a quarter of its time.

    The digits are those of one product, rounded once, unless it is near a tie; a whole number of six digits
    by an exact power of ten is rounded once too (Clinger 1990). Large and tiny values take the slow way.
    """
    magnitude = abs(x)
    if not _SMALLEST < magnitude < _LARGEST:
        return float(round_wire(x))
    _, exponent = math.frexp(magnitude)
    places = SIGNIFICANT_DIGITS - 1 - math.floor((exponent - 1) * _LOG10_OF_2)
    scaled = magnitude * _POWERS_OF_TEN[places]
    if scaled >= _FIRST_BEYOND:  # a power of two tells its power of ten, or the one below
        places -= 1
        scaled = magnitude * _POWERS_OF_TEN[places]
    below = math.floor(scaled)
    rest = scaled - below
    if abs(rest - 0.5) < _TIE:
        return float(round_wire(x))
    digits = below + 1.0 if rest > 0.5 else float(below)
    return math.copysign(digits / _POWERS_OF_TEN[places], x)


@part
def take_hold(arm: Arm, memory: Memory) -> bool:
    """Have the hand hold the arm as it intends, or let go; False where it is out of range."""
    counts, numbers, state = memory.counts, memory.numbers, arm.state
    if counts[N_HAND] == 1:
        for i in range(HAND_SIZE):
            if not numbers[F_HAND_LOW + i] <= numbers[F_HAND + i] <= numbers[F_HAND_HIGH + i]:
                return False
        for i in range(HAND_SIZE):
            state[S_HAND_POSITION + i] = numbers[F_HAND + i]
        state[S_HAND_AGE] = 0.0
        state[S_HAND_GAIN] = 1.0
        state[S_HAND_RELEASED] = 0.0
    elif counts[N_HAND] == 2:
        state[S_HAND_RELEASED] = 1.0
    counts[N_HAND] = 0
    return True


@part
def has_switch(memory: Memory) -> bool:
    """Whether a spring has to be enabled or disabled."""
    first = ASSIST if memory.p[P_BY_FORCE] > 0.0 else 0
    for spring in range(first, SPRINGS):
        is_on = memory.s[spring * SPRING_STRIDE + PHASE] != ADMITTANCE
        if is_on != (memory.counts[N_ENABLED + spring] != 0):
            return True
    return False


@part
def command(arm: Arm, memory: Memory) -> bool:
    """Set what changed in the device's objects, as it would be said; False where it would be refused."""
    s, counts, numbers, effects = memory.s, memory.counts, memory.numbers, arm.effects
    first = ASSIST if memory.p[P_BY_FORCE] > 0.0 else 0
    for spring in range(first, SPRINGS):
        base = spring * SPRING_STRIDE
        if s[base + PHASE] == ADMITTANCE:
            continue
        row = counts[N_PLACES + spring]
        axis = min(spring, AXES - 1)
        for index in range(PHASE):
            value = s[base + index]
            if value == numbers[F_TOLD + base + index]:
                continue
            wire = round_quickly(value)
            low = numbers[F_SPRING_LIMIT + 2 * index]
            if not low <= wire <= numbers[F_SPRING_LIMIT + 2 * index + 1]:
                return False
            if index == REFERENCE:
                place = row + E_POSITION + axis
            elif index == VELOCITY:
                place = row + E_VELOCITY + axis
            else:
                place = row + E_MAX_FORCE
            effects[place] = wire
            numbers[F_TOLD + base + index] = value
    for axis in range(AXES):
        value = s[S_PUSH + axis]
        told = F_TOLD + SPRINGS * SPRING_STRIDE + axis
        if value != numbers[told]:
            wire = round_quickly(value)
            if not numbers[F_BIAS_LIMIT] <= wire <= numbers[F_BIAS_LIMIT + 1]:
                return False
            effects[counts[N_PLACES + SPRINGS] + E_BIAS + axis] = wire
            numbers[told] = value
    return True


@part
def compute(arm: Arm, memory: Memory, dt: float) -> bool:
    """Take the measurement and run the cycle function; False where a limit trips, and all is as before."""
    s, m, before, outputs = memory.s, memory.m, memory.before, arm.outputs
    for i in range(STATE_SIZE):
        before[i] = s[i]
    for i in range(MEASUREMENT_SIZE):
        before[STATE_SIZE + i] = m[i]
    for i in range(AXES):
        m[i] = round_quickly(outputs[O_MEASURED_POSITION + i])
        m[AXES + i] = round_quickly(outputs[O_MODEL_VELOCITY + i])
        m[2 * AXES + i] = round_quickly(outputs[O_MEASURED_FORCE + i])
    if cycle(s, memory.p, memory.u, m, dt) == OK:
        return True
    for i in range(STATE_SIZE):
        s[i] = before[i]
    for i in range(MEASUREMENT_SIZE):
        m[i] = before[STATE_SIZE + i]
    return False


@part
def tell_state(memory: Memory, time_ns: int) -> None:
    """Tell the session where the loop stands, in the order of `LoopState`."""
    s, numbers = memory.s, memory.numbers
    numbers[F_LOOP_STATE] = memory.counts[N_CYCLES]
    numbers[F_LOOP_STATE + 1] = time_ns
    numbers[F_LOOP_STATE + 2] = 0.0
    numbers[F_LOOP_STATE + 3] = s[S_SATURATED]
    at = F_LOOP_STATE + 4
    for i in range(MEASUREMENT_SIZE):
        numbers[at + i] = memory.m[i]
    at += MEASUREMENT_SIZE
    for axis in range(AXES):
        base = axis * SPRING_STRIDE
        numbers[at + axis] = s[base + REFERENCE]
        numbers[at + AXES + axis] = s[S_FORCE + axis]
        numbers[at + 2 * AXES + axis] = s[base + PHASE]
    numbers[at + 3 * AXES] = s[S_FORCE + ASSIST]


@entry_point
def run_cycles(
    arm: Arm,
    active_effects: int,
    next_step: int,
    is_ready: bool,  # noqa: FBT001  # flat scalars, for the compiler
    memory: Memory,
    until: int,
    start_ns: int,
    period_ns: int,
) -> int:
    """Run cycles until so many have been run since the start, or Python is needed.

    Args:
        arm: The emulator.
        active_effects: How many of its effects are enabled.
        next_step: Step of the emulator from which on Python has to run it.
        is_ready: Whether it is in the state that the loop needs, and answers.
        memory: The loop's memory.
        until: Number of cycles since the start of the loop.
        start_ns: Deadline 0 on the virtual clock [ns].
        period_ns: Time between two cycles [ns].
    """
    counts = memory.counts
    dt = period_ns * 1e-9
    if not take_hold(arm, memory):
        return REFUSED
    while counts[N_CYCLES] < until:
        if counts[N_IS_ADVANCED] == 0:
            time_ns = start_ns + counts[N_CYCLES] * period_ns
            due = time_ns * STEP_RATE_HZ // 1_000_000_000
            if due >= next_step:
                return ADVANCE
            if due > counts[N_STEP]:
                counts[N_STEP] += advance(
                    arm.state,
                    arm.params,
                    arm.effects,
                    arm.active,
                    active_effects,
                    arm.outputs,
                    due - counts[N_STEP],
                )
                if arm.outputs[O_GUARD] != 0.0:
                    return ADVANCE
            counts[N_IS_ADVANCED] = 1
        if not is_ready:
            return UNUSUAL
        if has_switch(memory):
            return SWITCH
        if not command(arm, memory):
            return UNUSUAL
        if not compute(arm, memory, dt):
            return UNUSUAL
        counts[N_CYCLES] += 1
        counts[N_IS_ADVANCED] = 0
    tell_state(memory, start_ns + (counts[N_CYCLES] - 1) * period_ns)
    return DONE
