import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hm_driver.errors import DeviceError, ProtocolError
from hm_driver.protocol.framing import Dialect, render_value
from hm_driver.protocol.numbers import format_number
from hm_driver.protocol.replies import (
    parse_bool,
    parse_number,
    parse_quaternion,
    parse_vector,
    parse_word,
    raise_if_error,
    split_parts,
    split_reply,
)


def as_printed(x):
    return float(format_number(x))


numbers = st.floats(-1e9, 1e9).map(as_printed)
dialects = pytest.mark.parametrize("dialect", list(Dialect))


@dialects
@given(vector=st.tuples(numbers, numbers, numbers))
def test_a_vector_that_was_rendered_reads_back(dialect, vector):
    assert parse_vector(render_value(vector, dialect)) == vector


@dialects
@given(number=numbers, quaternion=st.tuples(numbers, numbers, numbers, numbers), flag=st.booleans())
def test_what_was_rendered_reads_back(dialect, number, quaternion, flag):
    assert parse_number(render_value(number, dialect)) == number
    assert parse_quaternion(render_value(quaternion, dialect)) == quaternion
    assert parse_bool(render_value(flag, dialect)) is flag


@dialects
@pytest.mark.parametrize("word", ["stop", "Linux", "Effect spring with name X created"])
def test_words_and_messages_read_back(dialect, word):
    assert parse_word(render_value(word, dialect)) == word


def test_a_text_reply_splits_at_its_semicolons():
    assert split_parts("[0,0,0];[1,2,3];stop;") == ["[0,0,0]", "[1,2,3]", "stop"]


def test_a_reply_that_is_not_closed_was_cut_off():
    with pytest.raises(ProtocolError, match="cut off"):
        split_parts("[0,0,0];[1,2")


def test_a_framed_reply_is_one_part():
    assert split_reply('"stop"') == ['"stop"']
    assert split_reply("stop;2;") == ["stop", "2"]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[",
        "[]",
        "[1,2]",
        "[1,2,3,4]",
        "[1,2,x]",
        "1,2,3",
        "[1,2,nan]",
        "[inf,-inf,0]",
        "[1_0,2,3]",
        "stop",
    ],
)
def test_what_is_no_vector_is_refused(text):
    with pytest.raises(ProtocolError, match="vector"):
        parse_vector(text)


@pytest.mark.parametrize("text", ["", "x", "nan", "inf", "1_0", "[1,2,3]", "1,5"])
def test_what_is_no_number_is_refused(text):
    with pytest.raises(ProtocolError, match="number"):
        parse_number(text)


@pytest.mark.parametrize("text", ["", "True", "1", "yes", '"true'])
def test_what_is_no_truth_value_is_refused(text):
    with pytest.raises(ProtocolError):
        parse_bool(text)


@given(st.text())
def test_any_text_is_read_or_refused_by_a_protocol_error(text):
    for parse in (parse_vector, parse_quaternion, parse_number, parse_bool, parse_word, split_parts):
        with contextlib.suppress(ProtocolError):
            parse(text)


@pytest.mark.parametrize("reply", ["--- ERROR: no such name;", '"--- ERROR: no such name"'])
def test_an_error_reply_becomes_an_exception_with_command_and_reply(reply):
    with pytest.raises(DeviceError) as caught:
        raise_if_error("get x pos", reply)
    assert caught.value.command == "get x pos"
    assert caught.value.reply == "--- ERROR: no such name"


def test_other_replies_raise_nothing():
    raise_if_error("get state", "stop;")
