import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.in_process import LockstepEmulator
from hm_driver.protocol.framing import Dialect, ReplyDecoder, encode_request
from hm_driver.protocol.vocabulary import OBJECT_TYPES, QUANTITIES, Kind, Parameter


@pytest.fixture(scope="module")
def device():
    """One emulator for the tests that do not care what it holds."""
    return LockstepEmulator(init_seconds=0.2)


@pytest.fixture
def fresh():
    return LockstepEmulator(init_seconds=0.2)


def ask(emulator: LockstepEmulator, text: str) -> str:
    return emulator.handle(text.encode() + b"\n").decode()


def ask_framed(emulator: LockstepEmulator, text: str) -> str:
    data = emulator.handle(encode_request(Dialect.FRAMED, text))
    assert len(data) < 128
    (reply,) = ReplyDecoder(Dialect.FRAMED).feed(data)
    return reply


def initialise(emulator: LockstepEmulator) -> None:
    ask(emulator, "set state init")
    start = emulator.device.step * 400_000
    for tick in range(1, 500):
        emulator.advance_to_ns(start + tick * 10_000_000)
        if ask(emulator, "get state") == "stop;\n":
            return
    pytest.fail("the initialisation did not end")


def sample(parameter: Parameter) -> str:
    """A value that the parameter takes, as text that reads back the same."""
    if parameter.kind is Kind.NUMBER:
        return f"{min(max(parameter.low, 0.25), parameter.high):g}"
    return {
        Kind.VECTOR: "[0.25,0.5,0.125]",
        Kind.UNIT_VECTOR: "[0,0,1]",
        Kind.QUATERNION: "[0,0,1,0]",
        Kind.BOOL: "true",
    }[parameter.kind]


@pytest.mark.parametrize("name", QUANTITIES)
def test_every_quantity_can_be_asked_for_in_both_dialects(device, name):
    text, framed = ask(device, f"get {name}"), ask_framed(device, f"get {name}")
    assert text.endswith(";\n")
    assert "ERROR" not in text
    quotes = QUANTITIES[name].kind in (Kind.WORD, Kind.BOOL)
    assert framed == (f'"{text[:-2]}"' if quotes else text[:-2])


@pytest.mark.parametrize("kind", OBJECT_TYPES)
def test_every_parameter_of_every_type_is_set_acknowledged_and_read_back(fresh, kind):
    assert ask(fresh, f"create {kind} X_1") == f"Effect {kind} with name X_1 created;\n"
    for parameter in OBJECT_TYPES[kind].parameters.values():
        value = sample(parameter)
        for _ in range(3):
            assert ask(fresh, f"set X_1 {parameter.name} {value}") == f"{parameter.reply};\n"
        assert ask(fresh, f"get X_1 {parameter.name}") == f"{value};\n"
        assert ask_framed(fresh, f"set X_1 {parameter.name} {value}") == f'"{parameter.reply}"'


@pytest.mark.parametrize("kind", OBJECT_TYPES)
def test_defaults_are_what_the_vocabulary_says(fresh, kind):
    ask(fresh, f"create {kind} X")
    for parameter in OBJECT_TYPES[kind].parameters.values():
        default = parameter.default
        shown = {True: "true", False: "false"}[default] if isinstance(default, bool) else None
        if shown is None:
            shown = (
                "[" + ",".join(f"{x:g}" for x in default) + "]"
                if isinstance(default, tuple)
                else f"{default:g}"
            )
        assert ask(fresh, f"get X {parameter.name}") == f"{shown};\n"


def test_new_objects_are_disabled_and_follow_enable_and_disable(fresh):
    ask(fresh, "create damper d")
    assert ask(fresh, "get d enabled") == "false;\n"
    assert "enabled" in ask(fresh, "set d enable")
    assert ask(fresh, "get d enabled") == "true;\n"
    assert "disabled" in ask(fresh, "set d disable")
    assert ask_framed(fresh, "get d enabled") == '"false"'


def test_stop_disables_the_objects_and_keeps_them(fresh):
    initialise(fresh)
    ask(fresh, "set state force; create spring s; set s stiffness 100; set s enable")
    assert ask(fresh, "set state stop; get s enabled; get s stiffness") == "state set to 'stop';false;100;\n"


def test_directions_and_quaternions_are_normalised(fresh):
    ask(fresh, "create flatplane p; set p normal [0,3,4]; set p att [0,0,2,0]")
    assert ask(fresh, "get p normal; get p att") == "[0,0.6,0.8];[0,0,1,0];\n"


@pytest.mark.parametrize(
    ("command", "named"),
    [
        ("", "get set create remove calibrateforcesensor"),
        ("hello", "get set create remove calibrateforcesensor"),
        ("GET measpos", "get set create remove calibrateforcesensor"),
        ("get", "measpos"),
        ("get nothing", "measpos"),
        ("get ghost pos", "s"),
        ("set ghost pos [0,0,0]", "s"),
        ("remove ghost", "s"),
        ("create spring s", "exists"),
        ("create wobble w", "spring damper"),
        ("create spring measpos", "word of the command language"),
        ("create spring 1st", "letter"),
        ("create spring", "create TYPE NAME"),
        ("set s nothing 1", "stiffness"),
        ("set s stiffness", "enable"),
        ("set s stiffness abc", "finite number"),
        ("set s stiffness -1", "0 to"),
        ("set s stiffness [1,2,3]", "number"),
        ("set s stiffness nan", "finite"),
        ("set s stiffness 1_0", "finite"),
        ("set s stiffness 1e999", "finite"),
        ("set s stiffness true", "number"),
        ("set s pos 1", "[x,y,z]"),
        ("set s pos [1,2]", "[x,y,z]"),
        ("set s pos [0,0,0,1]", "[x,y,z]"),
        ("set s pos [0,0,inf]", "[x,y,z]"),
        ("set s pos [0,0,nan]", "[x,y,z]"),
        ("set s pos [0,0,5]", "-2 to 2"),
        ("set s pos ]0,0,0[", "[x,y,z]"),
        ("set s pos [0,0,0", "[x,y,z]"),
        ("set s pos [0,0,0]]", "[x,y,z]"),
        ("set s pos [[0,0,0]]", "[x,y,z]"),
        ("set s att [0,0,0,0]", "direction"),
        ("set s dampglobal 1", "true or false"),
        ("set inertia 1.5", "2 to"),
        ("set inertia heavy", "finite number"),
        ("set measpos [0,0,0]", "set NAME"),
        ("set state fault", "init"),
        ("set state sleep", "force"),
        ("set state force", "set state init"),
        ("calibrateforcesensor now", "no argument"),
        ("remove", "remove NAME"),
    ],
)
def test_a_refusal_names_what_would_be_accepted(fresh, command, named):
    ask(fresh, "create spring s; set s pos [0,0,0]")
    reply = ask(fresh, command)
    assert reply.startswith("--- ERROR: ")
    assert named in reply
    assert ask_framed(fresh, command).startswith('"--- ERROR: ')


def test_a_refused_command_keeps_none_of_the_others_from_being_carried_out(fresh):
    reply = ask(fresh, "create spring a; set a pos [0,0,9]; set a vel [0,0,0.5]; get a vel")
    parts = reply.rstrip(";\n").split(";")
    assert parts[0] == "Effect spring with name a created"
    assert parts[1].startswith("--- ERROR")
    assert parts[3] == "[0,0,0.5]"


def test_blanks_and_a_trailing_separator_are_accepted(fresh):
    assert ask(fresh, "create spring b ; set b pos [ 0.5 , 0 , 0 ] ; get b pos ;") == (
        "Effect spring with name b created;Effect's position set;[0.5,0,0];\n"
    )


def test_remove_all_empties_the_device(fresh):
    for i in range(64):
        assert "created" in ask(fresh, f"create sphere s{i}")
    assert "no room" in ask(fresh, "create sphere one_more")
    assert ask(fresh, "remove all") == "Removed;\n"
    assert "created" in ask(fresh, "create sphere one_more")
    assert ask(fresh, "remove one_more") == "Removed;\n"
    assert "ERROR" in ask(fresh, "remove one_more")


def test_an_object_that_was_removed_and_made_anew_is_another_one(fresh):
    ask(fresh, "create spring a; create spring b")
    for _ in range(3):
        assert ask(fresh, "set a pos [1,0,0]") == "Effect's position set;\n"
    ask(fresh, "remove a; create damper a")
    assert ask(fresh, "get a pos; get b pos") == "[0,0,0];[0,0,0];\n"
    ask(fresh, "remove a")
    assert "ERROR" in ask(fresh, "set a pos [1,0,0]")


def test_the_workspace_is_that_of_the_arm(device):
    assert ask(device, "get workspace_r; get workspace_phi; get workspace_z") == (
        "[-0.19,0.45,0.19];[-0.504,0,0.507];[-0.228,0,0.228];\n"
    )


def test_too_many_commands_in_one_request_are_refused(device):
    assert "accepted: 64" in ask(device, ";".join(["get os"] * 65))
    assert ask(device, ";".join(["get os"] * 64)) == "Linux;" * 64 + "\n"


number = st.floats(-3.0, 3.0).map(lambda x: f"{x:g}") | st.sampled_from(
    ["nan", "inf", "1_0", "", " 1 ", "2", "x"]
)
bracket = st.lists(number, min_size=2, max_size=4).map(lambda parts: "[" + ",".join(parts) + "]")
piece = st.one_of(
    st.tuples(st.sampled_from(["set a pos ", "set b vel ", " set a vel ", "set ghost pos "]), bracket).map(
        "".join
    ),
    st.sampled_from(["get measpos", " get measforce", "get a pos", "get state", "", "get modelpos "]),
)


@settings(max_examples=150, deadline=None)
@given(st.lists(st.lists(piece, min_size=1, max_size=5), min_size=1, max_size=4))
def test_the_short_cut_answers_as_the_commands_one_by_one(requests):
    fast, slow = LockstepEmulator(), LockstepEmulator()
    for emulator in (fast, slow):
        ask(emulator, "create spring a; create damper b")
    for pieces in requests:
        for _ in range(2):
            combined = ask(fast, ";".join(pieces))
            if len(pieces) > 1 and not pieces[-1].strip():
                pieces = pieces[:-1]
            singly = "".join(framed_free(slow, piece) for piece in pieces)
            assert combined == singly + "\n"


def framed_free(emulator: LockstepEmulator, piece: str) -> str:
    """Answer to one command by the long way: the framed dialect has no short cut."""
    from hm_driver.protocol.commands import format_value

    return format_value(emulator._interpreter._carry_out(piece.strip())) + ";"


def test_measurements_have_six_digits_and_no_nan(device):
    parts = ask(device, "get measpos; get measvel; get measforce; get modelacc").rstrip(";\n").split(";")
    for part in parts:
        assert part[0] == "["
        assert part[-1] == "]"
        assert all(math.isfinite(float(x)) for x in part[1:-1].split(","))
