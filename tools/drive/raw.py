"""Commands of the device's own language: which the loop forbids while it drives, and why one was refused."""

from collections.abc import Callable, Iterable

from hm_driver.errors import ProtocolError
from hm_driver.protocol.commands import (
    VERBS,
    CalibrateForceSensor,
    Command,
    Create,
    Disable,
    Enable,
    GetParameter,
    Remove,
    RemoveAll,
    SetParameter,
    SetQuantity,
    parse_command,
)
from hm_driver.protocol.vocabulary import (
    ENABLED,
    OBJECT_TYPES,
    QUANTITIES,
    SETTABLE_QUANTITIES,
    SETTABLE_STATES,
    Parameter,
)
from hm_driver.realtime.options import BIAS_NAME, SPRING_NAMES
from tools.config_types import suggestion
from tools.drive.effects import EffectTable

LOOP_OBJECTS = (*SPRING_NAMES, BIAS_NAME)
"""Names of the objects that the loop keeps on the device while it drives."""


def read_command(text: str) -> Command | None:
    """The command that a line is, or None where our vocabulary does not know it."""
    try:
        return parse_command(text)
    except ProtocolError:
        return None


def is_question(text: str) -> bool:
    """Whether a line only asks, and changes nothing on the device."""
    return text.split(None, 1)[:1] == ["get"]


def object_of(command: Command | None) -> str:
    """Name of the object that a command is about, or an empty text."""
    match command:
        case Create(_, name) | Remove(name):
            return name
        case SetParameter(name, _, _) | GetParameter(name, _) | Enable(name) | Disable(name):
            return name
        case _:
            return ""


def why_forbidden(text: str) -> str:
    """Why a line must not be sent while the loop drives the arm; an empty text where it may.

    >>> why_forbidden("set inertia 5")
    "the loop's damping is computed for its own inertia; use 'inertia 5', or 'stop' first"
    """
    if is_question(text):
        return ""
    command = read_command(text)
    match command:
        case None:
            return (
                "it is not in the vocabulary, so what it would do to the arm is not known; 'stop' first, and "
                "the device will answer it"
            )
        case SetQuantity("state", state):
            return (
                "the loop would take another state for a fault and stop the arm; "
                f"use 'state {state}', or 'stop' first"
            )
        case SetQuantity("inertia", value):
            return (
                f"the loop's damping is computed for its own inertia; use 'inertia {value:g}', "
                "or 'stop' first"
            )
        case RemoveAll():
            return f"it would remove the loop's own objects too; use 'effect remove all', or {_STOP_FIRST}"
        case CalibrateForceSensor():
            return f"the arm would start to move under a hand that pushes meanwhile; {_STOP_FIRST}"
        case _ if object_of(command) in LOOP_OBJECTS:
            return f"'{object_of(command)}' is the loop's own; use another name, or {_STOP_FIRST}"
        case _:
            return ""


_STOP_FIRST = "'stop' first"


class Explainer:
    """Says in plain words why the device refused a command, and what it would accept.

    Args:
        table: The objects that this drive made.
        ask: Asks the device a question and returns its answer; for what only the device knows.
    """

    def __init__(self, table: EffectTable, ask: Callable[[str], str]) -> None:
        self._table = table
        self._ask = ask

    def explain(self, text: str) -> str:
        """What is wrong with a line that the device refused, as far as it is known here."""
        words = text.strip("; \t").split(None, 3)
        command = read_command(text)
        if command is None:
            return self._explain_unknown(words, text)
        match command:
            case SetQuantity("state", state):
                return self._explain_state(str(state))
            case Create(_, name) if name in self._table.objects:
                return f"there is a {self._table.objects[name].type.name} of that name; remove it first"
            case Create(_, name):
                return (
                    f"an object {name!r} may be there that another program made ('remove {name}'), "
                    "or there is no room for more"
                )
            case GetParameter() | SetParameter() | Enable() | Disable() | Remove():
                return self._explain_object(command)
            case _:
                return "our vocabulary would accept it: this firmware differs, or its state does not allow it"

    def _explain_unknown(self, words: list[str], text: str) -> str:
        if not words or words[0] not in VERBS:
            verb = words[0] if words else ""
            return f"{verb!r} is no verb{_near(verb, VERBS)}; accepted: {' '.join(VERBS)}"
        if words[0] == "get" and len(words) == 2:
            return (
                f"{words[1]!r} is no quantity{_near(words[1], QUANTITIES)}; accepted: {' '.join(QUANTITIES)}"
            )
        if words[0] == "create" and len(words) == 3 and words[1] not in OBJECT_TYPES:
            return (
                f"{words[1]!r} is no type{_near(words[1], OBJECT_TYPES)}; accepted: {' '.join(OBJECT_TYPES)}"
            )
        if words[0] == "set" and words[1:2] == ["state"] and len(words) == 3:
            near = _near(words[2], SETTABLE_STATES)
            return f"{words[2]!r} is no state{near}; accepted: {' '.join(SETTABLE_STATES)}"
        named = (*SETTABLE_QUANTITIES, *self._table.objects)
        if words[0] == "set" and len(words) == 3 and words[1] not in named:
            near = _near(words[1], SETTABLE_QUANTITIES)
            settable = " ".join(SETTABLE_QUANTITIES)
            return (
                f"{words[1]!r} is nothing that can be set{near}; accepted: {settable}, "
                "or an object with a parameter and a value, enable or disable"
            )
        try:
            parse_command(text)
        except ProtocolError as error:
            return str(error)
        return ""

    def _explain_state(self, state: str) -> str:
        if _says(self._ask, "get emergencybuttonpushed", "true"):
            return "the emergency button is pushed; release it"
        if _says(self._ask, "get state", "fault"):
            return "the device is in fault: find out why, then 'state init' (the arm moves) or 'state off'"
        if _says(self._ask, "get position_calibrated", "false"):
            return f"it has not found its end stops yet: 'state init' (the arm moves), then 'state {state}'"
        return "another state does not allow it now; 'state stop' is allowed from everywhere but fault"

    def _explain_object(self, command: GetParameter | SetParameter | Enable | Disable | Remove) -> str:
        name = object_of(command)
        known = self._table.objects.get(name)
        if known is None:
            names = " ".join(self._table.objects) or "none"
            near = _near(name, self._table.objects)
            return f"no object {name!r} was made here{near}; there are: {names}. 'create TYPE NAME' makes one"
        if not isinstance(command, GetParameter | SetParameter):
            return "our vocabulary would accept it: this firmware differs"
        kind = known.type
        accepted = " ".join(kind.parameters)
        if command.name == ENABLED.name and isinstance(command, GetParameter):
            return "our vocabulary would accept it: this firmware differs"
        if command.name not in kind.parameters:
            return (
                f"a {kind.name} has no {command.name!r}{_near(command.name, kind.parameters)}; "
                f"accepted: {accepted}"
            )
        parameter = kind.parameters[command.name]
        if isinstance(command, SetParameter):
            try:
                parameter.check(command.value)
            except ProtocolError as error:
                return f"{error}{_doc(parameter)}"
        return "our vocabulary would accept it: this firmware differs"


def doubts(text: str, table: EffectTable) -> str:
    """What is odd about a line that the device accepted; devices let unknown names pass in silence.

    Names of objects are only judged while all objects are known here to be ours.
    """
    command = read_command(text)
    if command is None:
        return "our vocabulary does not know this command"
    if isinstance(command, SetParameter | GetParameter) and command.object in table.objects:
        kind = table.objects[command.object].type
        if command.name not in kind.parameters and command.name != ENABLED.name:
            near = _near(command.name, kind.parameters)
            return (
                f"our vocabulary knows no {command.name!r} of a {kind.name}{near}: it may have had no effect"
            )
    return ""


def _near(word: str, known: Iterable[str]) -> str:
    return suggestion(word, known).rstrip("?").replace("; did you mean ", ": did you mean ")


def _doc(parameter: Parameter) -> str:
    return f" ({parameter.doc[0].lower()}{parameter.doc[1:]})"


def _says(ask: Callable[[str], str], question: str, answer: str) -> bool:
    try:
        return ask(question) == answer
    except (OSError, ValueError, RuntimeError):  # the device has already refused one thing: keep to that
        return False
