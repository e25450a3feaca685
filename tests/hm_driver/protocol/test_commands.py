import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hm_driver.errors import ProtocolError
from hm_driver.protocol import commands as c
from hm_driver.protocol.numbers import format_number
from hm_driver.protocol.vocabulary import (
    MAX_NAME_LENGTH,
    OBJECT_TYPES,
    QUANTITIES,
    SETTABLE_STATES,
    check_name,
)


def is_name(text):
    try:
        check_name(text)
    except ProtocolError:
        return False
    return True


def as_printed(x):
    return float(format_number(x))


names = st.from_regex(r"[A-Za-z_][A-Za-z0-9_.\-]{0,20}", fullmatch=True).filter(is_name)
numbers = st.floats(-1e6, 1e6).map(as_printed)
values = (
    numbers
    | st.booleans()
    | st.tuples(numbers, numbers, numbers)
    | st.tuples(numbers, numbers, numbers, numbers)
)
parameters = st.sampled_from(sorted({name for kind in OBJECT_TYPES.values() for name in kind.parameters}))
any_command = st.one_of(
    st.builds(c.GetQuantity, st.sampled_from(sorted(QUANTITIES))),
    st.builds(c.SetQuantity, st.just("state"), st.sampled_from(SETTABLE_STATES)),
    st.builds(c.SetQuantity, st.just("inertia"), st.floats(2.0, 100.0).map(as_printed)),
    st.builds(c.GetParameter, names, parameters | st.just("enabled")),
    st.builds(c.SetParameter, names, parameters, values),
    st.builds(c.Create, st.sampled_from(sorted(OBJECT_TYPES)), names),
    st.builds(c.Remove, names),
    st.just(c.RemoveAll()),
    st.builds(c.Enable, names),
    st.builds(c.Disable, names),
    st.just(c.CalibrateForceSensor()),
)


@given(any_command)
def test_a_command_that_was_encoded_parses_to_itself(command):
    assert c.parse_command(command.encode()) == command


@given(any_command, st.sampled_from(["", " ", ";", " ; ", ";\r"]))
def test_a_trailing_blank_or_semicolon_is_accepted(command, ending):
    assert c.parse_command(command.encode() + ending) == command


@given(st.lists(any_command, min_size=1, max_size=12), st.sampled_from(["; ", ";", " ; "]))
def test_a_request_of_several_commands_splits_into_them(several, separator):
    request = separator.join(command.encode() for command in several)
    assert [c.parse_command(part) for part in c.split_request(request)] == several
    assert c.split_request(request + ";") == c.split_request(request)


@given(st.text() | st.text("getsremovcl [],;.0123456789-+efx_", max_size=60))
def test_any_text_is_a_command_or_a_protocol_error(text):
    with contextlib.suppress(ProtocolError):
        command = c.parse_command(text)
        assert type(c.parse_command(command.encode())) is type(command)


def test_blanks_inside_brackets_are_accepted():
    assert c.parse_command("set ballForce force [ 0 , 1.25,0 ]") == c.SetParameter(
        "ballForce", "force", (0.0, 1.25, 0.0)
    )


def test_letter_case_of_names_matters():
    assert c.parse_command("remove Ball") != c.parse_command("remove ball")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "get set create remove calibrateforcesensor"),
        ("GET state", "get set create remove calibrateforcesensor"),
        ("get", "get NAME PARAMETER"),
        ("get speed", "measpos"),
        ("get a b c", "get NAME PARAMETER"),
        ("set", "set NAME enable"),
        ("set spring stiffness", "set NAME PARAMETER VALUE"),
        ("set spring stiffness soft", "a finite number"),
        ("set spring stiffness nan", "a finite number"),
        ("set spring stiffness inf", "a finite number"),
        ("set spring stiffness 1_000", "a finite number"),
        ("set spring pos [0,0]", r"\[x,y,z\]"),
        ("set spring pos [0,0,nan]", r"\[x,y,z\]"),
        ("set spring pos [inf,-inf,0]", r"\[x,y,z\]"),
        ("set spring pos [0,0,0", r"\[x,y,z\]"),
        ("set state run", "off init stop position force home"),
        ("set state fault", "off init stop position force home"),
        ("set inertia 1", "2 to 100 kg"),
        ("set inertia heavy", "a finite number"),
        ("set inertia 3 4", "2 to 100 kg"),
        ("set measpos [0,0,0]", "set inertia VALUE"),
        ("create", "create TYPE NAME"),
        ("create spring", "create TYPE NAME"),
        ("create pyramid p", "flatplane"),
        ("create spring all", "cannot name an object"),
        ("create spring state", "cannot name an object"),
        ("create spring 1st", "a letter"),
        (f"create spring {'a' * (MAX_NAME_LENGTH + 1)}", "at most 64"),
        ("remove", "remove all"),
        ("remove a b", "remove all"),
        ("calibrateforcesensor now", "no argument"),
    ],
)
def test_a_wrong_command_is_refused_with_what_would_be_accepted(text, said):
    with pytest.raises(ProtocolError, match=said):
        c.parse_command(text)


def test_a_command_of_a_megabyte_is_refused_with_a_short_reason():
    with pytest.raises(ProtocolError) as caught:
        c.parse_command("get " + "x" * 1_000_000)
    assert len(str(caught.value)) < 1000


def test_a_value_that_is_not_finite_cannot_be_sent():
    with pytest.raises(ProtocolError):
        c.SetParameter("a", "stiffness", float("nan")).encode()


def test_a_name_that_would_smuggle_in_a_command_is_refused():
    with pytest.raises(ProtocolError):
        c.Create("spring", "a; set state force")
