"""From the cycle's state to the device's commands: only what changed is said."""

from hm_driver.realtime.cycle import (
    ADMITTANCE,
    ASSIST,
    CAP,
    PHASE,
    REFERENCE,
    S_PUSH,
    SPRING_STRIDE,
    SPRINGS,
    VELOCITY,
)
from hm_driver.realtime.options import BIAS_NAME, SPRING_NAMES

_AXIS_VALUES = ("[%s,0,0]", "[0,%s,0]", "[0,0,%s]", "[0,0,%s]")

SPRING_COMMANDS = tuple(
    (
        f"set {name} pos {value}",
        f"set {name} vel {value}",
        f"set {name} maxforce %s",
        f"set {name} enable",
        f"set {name} disable",
    )
    for name, value in zip(SPRING_NAMES, _AXIS_VALUES, strict=True)
)
"""For each spring: what sets its reference, the reference's velocity and the cap, enables and disables it."""
BIAS_COMMAND = f"set {BIAS_NAME} force [%g,%g,%g]"
"""What sets the bias force."""


_X, _Y, _Z, _ASSIST = (spring * SPRING_STRIDE + PHASE for spring in range(SPRINGS))


class EffectCommands:
    """Turns the state of the springs and the bias force into the commands of one cycle.

    A value is said again when its text on the wire (six significant digits) has changed. A spring is disabled
    once it is released, and enabled behind its first values.

    Args:
        are_springs_ours: Whether the loop renders the springs of position mode by the bias force; the
            device's are then left alone.
    """

    __slots__ = ("_bias", "_enabled", "_has_enabled", "_sent", "_sets", "_springs", "_texts")

    def __init__(self, *, are_springs_ours: bool = False) -> None:
        self._springs = (ASSIST,) if are_springs_ours else (0, 1, 2, ASSIST)
        self._sets = SPRING_COMMANDS
        nothing = float("nan")
        self._sent = [nothing] * (SPRINGS * SPRING_STRIDE)
        self._texts = [""] * (SPRINGS * SPRING_STRIDE)
        self._enabled = [False] * SPRINGS
        self._has_enabled = False
        self._bias = (0.0, 0.0, 0.0)

    def resume(self, told: list[float], enabled: list[bool], bias: tuple[float, float, float]) -> None:
        """Go on from what the device was told by others.

        Args:
            told: As the springs' part of the state; NaN for nothing.
            enabled: Which springs are enabled.
            bias: The bias force [N].
        """
        self._sent[:] = told
        self._texts[:] = ["%g" % value for value in told]  # noqa: UP031  # as below
        self._enabled[:] = enabled
        self._has_enabled = any(enabled)
        self._bias = bias

    def changes(self, s: list[float]) -> list[str]:
        """Commands that bring the device from what it was told last to the state ``s`` of the cycle."""
        changes: list[str] = []
        if self._has_enabled or s[_X] or s[_Y] or s[_Z] or s[_ASSIST]:
            self._change_springs(s, changes)
        bias = (s[S_PUSH], s[S_PUSH + 1], s[S_PUSH + 2])
        if bias != self._bias:
            self._bias = bias
            changes.append(BIAS_COMMAND % bias)  # as %g is the wire's
        return changes

    def _change_springs(self, s: list[float], changes: list[str]) -> None:
        enabled = self._enabled
        for spring in self._springs:
            base = spring * SPRING_STRIDE
            if s[base + PHASE] != ADMITTANCE:
                self._move(spring, s, base, changes)
            elif enabled[spring]:
                enabled[spring] = False
                changes.append(self._sets[spring][4])
        self._has_enabled = any(enabled)

    def _move(self, spring: int, s: list[float], base: int, changes: list[str]) -> None:
        sets, sent, texts = self._sets[spring], self._sent, self._texts
        for index in (REFERENCE, VELOCITY, CAP):
            at = base + index
            value = s[at]
            if value != sent[at]:
                sent[at] = value
                text = "%g" % value  # noqa: UP031  # the wire's
                if text != texts[at]:
                    texts[at] = text
                    changes.append(sets[index] % text)
        if not self._enabled[spring]:
            self._enabled[spring] = True
            changes.append(sets[3])
