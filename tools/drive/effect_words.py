"""The word ``effect``: springs, dampers, forces and shapes by name."""

from collections.abc import Iterable

from hm_driver.errors import ConfigurationError, ProtocolError
from hm_driver.protocol.commands import (
    Create,
    Disable,
    Enable,
    Remove,
    SetParameter,
    format_value,
    parse_value,
)
from hm_driver.protocol.vocabulary import OBJECT_TYPES, ObjectType, Value, check_name, object_type
from tools.config_types import suggestion
from tools.drive.language import Argument, Call, Option, Word
from tools.drive.raw import LOOP_OBJECTS
from tools.drive.session import Drive
from tools.drive.surface import Context

ACTIONS = ("list", "create", "set", "enable", "disable", "remove", "types")


def effect_word() -> Word[Context]:
    """The word."""
    return Word(
        name="effect",
        doc="Effects and shapes on the device: make, change, render, remove.",
        run=run,
        arguments=(
            Argument(name="ACTION", doc="what to do", choices=ACTIONS),
            Argument(name="WORDS", doc="see below", is_optional=True, is_repeated=True),
        ),
        options=(Option(name="--enable", doc="with create: render it at once"),),
        more=(
            "effect create TYPE NAME [PARAMETER=VALUE ...] [--enable]\n"
            "effect set NAME PARAMETER=VALUE ...      effect enable|disable|remove NAME\n"
            "effect list                              effect types [TYPE]  (parameters, units, ranges)\n"
            "Vectors are [x,y,z]. What would pull the handle at once with more than "
            "modes.position_force_max is refused."
        ),
        stays=True,
    )


def run(context: Context, call: Call) -> None:
    """Carry the word out."""
    action, words = call.text("ACTION"), call.rest
    if call.has("--enable") and action != "create":
        raise ConfigurationError("effect --enable", "belongs to 'effect create'")
    if action == "types":
        _show_types(context, words)
        return
    drive = context.drive
    if action == "list":
        _expect("effect list", words, 0)
        _list(context)
    elif action == "create":
        _create(context, words, is_enabled=call.has("--enable"))
    elif action == "set":
        name = _known(drive, words, "effect set NAME PARAMETER=VALUE ...")
        _set(context, name, words[1:])
    else:
        _switch(context, action, words)


def _create(context: Context, words: tuple[str, ...], *, is_enabled: bool) -> None:
    if len(words) < 2:
        raise ConfigurationError(
            "effect create", "usage: effect create TYPE NAME [PARAMETER=VALUE ...] [--enable]"
        )
    kind = _type(words[0])
    name = words[1]
    drive = context.drive
    try:
        check_name(name)
    except ProtocolError as error:
        raise ConfigurationError("effect create NAME", str(error)) from error
    if name in LOOP_OBJECTS:
        raise ConfigurationError("effect create NAME", f"{name!r} is the loop's own; take another name")
    settings = [_setting(kind, text) for text in words[2:]]
    drive.send(Create(kind.name, name))
    try:
        for key, value in settings:
            drive.send(SetParameter(name, key, value))
        if is_enabled:
            drive.send(Enable(name))
    except Exception:
        drive.send(Remove(name))  # an object that is half set up is no use
        raise
    context.console.write(f"{kind.name} {name} created{', enabled' if is_enabled else ''}")
    _say_if_asleep(context, is_enabled=is_enabled)


def _set(context: Context, name: str, words: Iterable[str]) -> None:
    drive = context.drive
    kind = drive.effects.objects[name].type
    settings = [_setting(kind, text) for text in words]
    if not settings:
        raise ConfigurationError(
            "effect set", f"PARAMETER=VALUE is missing; a {kind.name} has {' '.join(kind.parameters)}"
        )
    for key, value in settings:
        drive.send(SetParameter(name, key, value))
    context.console.write(f"{name}: {', '.join(f'{key}={format_value(value)}' for key, value in settings)}")


def _switch(context: Context, action: str, words: tuple[str, ...]) -> None:
    drive = context.drive
    if action == "remove" and words == ("all",):
        for name in list(drive.effects.objects):
            drive.send(Remove(name))
        context.console.write("all removed")
        return
    name = _known(drive, words, f"effect {action} NAME")
    _expect(f"effect {action}", words, 1)
    drive.send(Enable(name) if action == "enable" else Disable(name) if action == "disable" else Remove(name))
    context.console.write(f"{name} {action}d")
    _say_if_asleep(context, is_enabled=action == "enable")


def _list(context: Context) -> None:
    objects = context.drive.effects.objects
    if not objects:
        context.console.write("none; 'effect create TYPE NAME' makes one")
    rows = []
    for name, known in objects.items():
        settings = " ".join(f"{key}={format_value(value)}" for key, value in known.settings.items())
        state = "enabled" if known.is_enabled else "disabled"
        rows.append((name, f"{known.type.name:<9}  {state:<8}  {settings}"))
    context.console.write_rows(rows)


def _show_types(context: Context, words: tuple[str, ...]) -> None:
    if not words:
        context.console.write_rows([(kind.name, f"{kind.doc}.") for kind in OBJECT_TYPES.values()])
        return
    kind = _type(words[0])
    context.console.write(f"{kind.name}: {kind.doc}")
    context.console.write_rows(
        [
            (
                f"    {parameter.name}",
                f"{parameter.doc}: {parameter.expected()}; unset: {format_value(parameter.default)}",
            )
            for parameter in kind.parameters.values()
        ]
    )


def _type(name: str) -> ObjectType:
    try:
        return object_type(name)
    except ProtocolError as error:
        raise ConfigurationError("effect TYPE", f"{error}{suggestion(name, OBJECT_TYPES)}") from error


def _setting(kind: ObjectType, text: str) -> tuple[str, Value]:
    key, equals, shown = text.partition("=")
    if not equals:
        raise ConfigurationError(
            f"effect {kind.name}", f"{text!r} is not of the form PARAMETER=VALUE, as in stiffness=200"
        )
    if key not in kind.parameters:
        raise ConfigurationError(
            f"effect {kind.name}",
            f"has no {key!r}{suggestion(key, kind.parameters).rstrip('?')}; "
            f"accepted: {' '.join(kind.parameters)}",
        )
    parameter = kind.parameters[key]
    try:
        return key, parameter.check_form(parse_value(shown.replace(" ", "")))
    except ProtocolError as error:
        raise ConfigurationError(
            f"effect {kind.name} {key}", f"{shown!r} is out of form; accepted: {parameter.expected()}"
        ) from error


def _known(drive: Drive, words: tuple[str, ...], usage: str) -> str:
    if not words:
        raise ConfigurationError("effect", f"NAME is missing; usage: {usage}")
    name = words[0]
    if name not in drive.effects.objects:
        names = " ".join(drive.effects.objects) or "none"
        near = suggestion(name, drive.effects.objects).rstrip("?")
        raise ConfigurationError("effect NAME", f"no effect {name!r} was made here{near}; there are: {names}")
    return name


def _expect(what: str, words: tuple[str, ...], count: int) -> None:
    if len(words) > count:
        raise ConfigurationError(what, f"{words[count]!r} is too much")


def _say_if_asleep(context: Context, *, is_enabled: bool) -> None:
    if is_enabled and not context.drive.is_driving and not context.is_one_shot:
        context.console.tell("the device renders it in state force or position: 'release' or 'hold' next")
