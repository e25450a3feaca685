"""Questions that make, change and remove objects, and set the virtual mass to what it is.

They are asked in the states off and stop alone, in which the device renders nothing; no object is enabled,
and all of them are removed again.
"""

from collections.abc import Callable

from hm_driver.protocol.commands import format_value
from hm_driver.protocol.vocabulary import ERROR_MARK, OBJECT_TYPES, ObjectType
from tools.check.comparison import Answer, Conversation, Question, Verdict, judge

NAME = "hmcheck"
"""Name of every object that is made."""
SAFE_STATES = ("off", "stop")
_OBJECTS = "block, sphere, flat plane, cylinder, torus and the names of their parameters"
_TEXTS = "names of commands and parameters, reply texts, `Shapes's stiffness set`"


def _guarded(ask: Callable[[Conversation], Answer]) -> Callable[[Conversation], Answer]:
    """Ask only where nothing is rendered, and leave no object behind."""

    def guarded(conversation: Conversation) -> Answer:
        state = conversation.ask("get state")
        if state not in SAFE_STATES:
            return Answer("state off or stop", f"state {state}: not asked", Verdict.UNKNOWN)
        try:
            return ask(conversation)
        finally:
            conversation.ask(f"remove {NAME}")

    return guarded


def _makes(kind: ObjectType) -> Callable[[Conversation], Answer]:
    def ask(conversation: Conversation) -> Answer:
        expected = f"Effect {kind.name} with name {NAME} created, and an acknowledgement of each parameter"
        reply = conversation.ask(f"create {kind.name} {NAME}")
        if f"Effect {kind.name} with name {NAME} created" not in reply:
            return judge(expected, reply, is_same=False)
        odd = []
        for name, parameter in kind.parameters.items():
            if parameter.reply:
                reply = conversation.ask(f"set {NAME} {name} {format_value(parameter.default)}")
                odd += [f"{name}: {reply}"] if parameter.reply not in reply else []
        return judge(expected, "; ".join(odd) or "as expected", is_same=not odd)

    return ask


def _new_is_disabled(conversation: Conversation) -> Answer:
    conversation.ask(f"create spring {NAME}")
    got = conversation.ask(f"get {NAME} enabled")
    return judge("false", got, is_same=got == "false")


def _name_is_taken(conversation: Conversation) -> Answer:
    conversation.ask(f"create spring {NAME}")
    got = conversation.ask(f"create spring {NAME}")
    return judge("a refusal of a name that is taken", got, is_same=ERROR_MARK in got)


def _removes(conversation: Conversation) -> Answer:
    conversation.ask(f"create spring {NAME}")
    got = conversation.ask(f"remove {NAME}")
    return judge("Removed", got, is_same="Removed" in got)


def _sets_mass(conversation: Conversation) -> Answer:
    mass = conversation.ask("get inertia")
    got = conversation.ask(f"set inertia {mass}")
    return judge("Inertia set", got, is_same="Inertia set" in got)


def _combines_sets(conversation: Conversation) -> Answer:
    if conversation.dialect != "text":
        return Answer("three parts", "not asked in the framed dialect", Verdict.UNKNOWN)
    mass = conversation.ask("get inertia")
    got = conversation.ask(f"get inertia; set inertia {mass}; get state")
    return judge("three parts in one reply", got, is_same=got.count(";") == 2)


ACTIVE = (
    Question(
        name="set the virtual mass", fact="names of commands and parameters, reply texts, "
        "`Shapes's stiffness set`", confidence="H, M", ask=_guarded(_sets_mass),
    ),
    Question(
        name="sets in one request",
        fact="several commands in one text request",
        confidence="H",
        ask=_guarded(_combines_sets),
    ),
    Question(
        name="new objects", fact="new objects are disabled", confidence="L", ask=_guarded(_new_is_disabled)
    ),
    Question(
        name="a name twice",
        fact="letters, length and reuse of an object's name",
        confidence="C",
        ask=_guarded(_name_is_taken),
    ),
    Question(name="remove", fact=_TEXTS, confidence="H, M", ask=_guarded(_removes)),
    *(
        Question(
            name=f"make a {kind.name}",
            fact=_OBJECTS if kind.is_shape else _TEXTS,
            confidence="H, M",
            ask=_guarded(_makes(kind)),
        )
        for kind in OBJECT_TYPES.values()
    ),
)  # fmt: skip
"""Asked only when they are asked for and confirmed."""
