"""The words that hold and release the arm, and say with what."""

from collections.abc import Callable, Iterable

from hm_driver.realtime.modes import PositionControl
from tools.drive.language import Argument, Call, Word
from tools.drive.pilot import ALL_AXES
from tools.drive.session import axis_index
from tools.drive.showing import SECONDS, wait
from tools.drive.status import AXES
from tools.drive.surface import Context

CONTROLS = {"spring": PositionControl.SPRING, "bias": PositionControl.BIAS_FORCE}


_AXES = Argument(name="AXIS", doc="only these axes", choices=tuple(AXES), is_optional=True, is_repeated=True)


def mode_words() -> Iterable[Word[Context]]:
    """The words."""
    yield Word(
        name="hold",
        doc="Hold the arm, or some axes, where they are (position mode).",
        run=lambda context, call: _after(context, call, lambda: context.drive.hold(_indices(call.rest))),
        arguments=(_AXES,),
        options=(SECONDS,),
        stays=True,
    )
    yield Word(
        name="release",
        doc="Let the hand move the arm, or some axes (admittance mode).",
        run=lambda context, call: _after(context, call, lambda: context.drive.release(_indices(call.rest))),
        arguments=(_AXES,),
        options=(SECONDS,),
        stays=True,
    )
    yield Word(
        name="mode",
        doc="As hold and release, by the mode's name.",
        run=_mode,
        arguments=(Argument(name="MODE", doc="mode", choices=("admittance", "position")), _AXES),
        options=(SECONDS,),
        stays=True,
    )
    yield Word(
        name="inertia",
        doc="Show or set the virtual mass that the hand moves.",
        run=_inertia,
        arguments=(
            Argument(
                name="MASS", doc="mass", is_number=True, unit="kg", low=2.0, high=20.0, is_optional=True
            ),
        ),
        more="A loop that runs starts anew with it; the arm stands still meanwhile, for about a second.",
    )
    yield Word(
        name="control",
        doc="Show or choose what position mode pulls with.",
        run=_control,
        arguments=(
            Argument(
                name="WAY",
                doc="spring on the device, or bias force by the loop",
                choices=tuple(CONTROLS),
                is_optional=True,
            ),
        ),
        more="spring: moving virtual springs of the device. bias: a PD law of the loop, sent as bias force.",
    )


def _mode(context: Context, call: Call) -> None:
    drive = context.drive
    act = drive.release if call.text("MODE") == "admittance" else drive.hold
    _after(context, call, lambda: act(_indices(call.rest)))


def _after(context: Context, call: Call, act: Callable[[], None]) -> None:
    act()
    say_mode(context)
    if call.has("--seconds"):
        wait(context, call.number("--seconds"))


def say_mode(context: Context) -> None:
    """Tell which axes are held and which are free."""
    pilot = context.drive.pilot
    if pilot is None:
        return
    held = [axis for axis, engaged in zip(AXES, pilot.engaged, strict=True) if engaged]
    free = [axis for axis in AXES if axis not in held]
    parts = [f"{' '.join(held)} held"] if held else []
    parts += [f"{' '.join(free)} free"] if free else []
    context.console.write(", ".join(parts))


def _inertia(context: Context, call: Call) -> None:
    drive = context.drive
    if call.has("MASS"):
        drive.set_inertia(call.number("MASS"))
    elif not drive.is_driving:
        context.console.write(
            f"{drive.arm.inertia:g} kg on the device; the loop sets {drive.options.modes.inertia:g} kg"
        )
        return
    context.console.write(f"inertia {drive.options.modes.inertia:g} kg")


def _control(context: Context, call: Call) -> None:
    drive = context.drive
    if call.has("WAY"):
        drive.set_control(CONTROLS[call.text("WAY")])
    now = drive.options.modes.position_control
    context.console.write(next(name for name, control in CONTROLS.items() if control is now))


def _indices(axes: tuple[str, ...]) -> tuple[int, ...]:
    return tuple(axis_index(axis) for axis in axes) or ALL_AXES
