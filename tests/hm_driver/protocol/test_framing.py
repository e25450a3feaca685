import contextlib
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hm_driver.errors import ProtocolError
from hm_driver.protocol.framing import (
    MAX_FRAMED_REPLY_LENGTH,
    Dialect,
    ReplyDecoder,
    RequestDecoder,
    encode_reply,
    encode_request,
    render_value,
)
from hm_driver.protocol.vocabulary import error_reply

dialects = pytest.mark.parametrize("dialect", list(Dialect))
lines = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), min_size=1, max_size=200)


def cut(data, places):
    places = sorted({place % (len(data) + 1) for place in places})
    return [data[a:b] for a, b in zip([0, *places], [*places, len(data)], strict=True)]


@dialects
@given(texts=st.lists(lines, min_size=1, max_size=5), places=st.lists(st.integers(0), max_size=8))
def test_requests_survive_being_cut_and_joined_at_any_byte(dialect, texts, places):
    decoder = RequestDecoder()
    data = b"".join(encode_request(dialect, text) for text in texts)
    assert [text for piece in cut(data, places) for text in decoder.feed(piece)] == texts
    assert decoder.dialect is dialect


@dialects
@given(texts=st.lists(lines, min_size=1, max_size=5), places=st.lists(st.integers(0), max_size=8))
def test_replies_survive_being_cut_and_joined_at_any_byte(dialect, texts, places):
    decoder = ReplyDecoder(dialect)
    data = b"".join(encode_request(dialect, text) for text in texts)
    assert [text for piece in cut(data, places) for text in decoder.feed(piece)] == texts
    assert decoder.is_empty


@given(st.lists(st.binary(max_size=300), max_size=20))
def test_any_bytes_leave_the_server_with_bounded_memory_or_a_protocol_error(pieces):
    decoder = RequestDecoder(limit=64)
    with contextlib.suppress(ProtocolError):
        for piece in pieces:
            decoder.feed(piece)
            assert len(decoder._buffer) <= 64 + 8
            assert all(text.isascii() for text in decoder.feed(b""))


@dialects
@given(pieces=st.lists(st.binary(max_size=300), max_size=20))
def test_any_bytes_leave_the_client_with_bounded_memory_or_a_protocol_error(dialect, pieces):
    decoder = ReplyDecoder(dialect, limit=64)
    with contextlib.suppress(ProtocolError):
        for piece in pieces:
            assert all(text.isascii() for text in decoder.feed(piece))
            assert len(decoder._buffer) <= 64 + 8


def test_a_framed_state_is_exactly_ten_bytes_for_position():
    frame = encode_reply(Dialect.FRAMED, [render_value("position", Dialect.FRAMED)])
    assert frame == b"\0\0\0\x0a\0\0\0\0" + b'"position"'


@pytest.mark.parametrize(
    ("value", "text", "framed"),
    [
        ("stop", "stop", '"stop"'),
        (True, "true", '"true"'),
        (False, "false", '"false"'),
        (2.3, "2.3", "2.3"),
        ((1.0, 0.5, -2.0), "[1,0.5,-2]", "[1,0.5,-2]"),
        ((0.0, 0.0, 0.0, 1.0), "[0,0,0,1]", "[0,0,0,1]"),
        ("Inertia set", "Inertia set", '"Inertia set"'),
    ],
)
def test_words_are_quoted_in_frames_only(value, text, framed):
    assert render_value(value, Dialect.TEXT) == text
    assert render_value(value, Dialect.FRAMED) == framed


def test_each_part_of_a_text_reply_is_closed_without_a_blank():
    assert encode_reply(Dialect.TEXT, ["[0,0,0]", "stop"]) == b"[0,0,0];stop;\n"


def test_a_long_error_is_shortened_to_fit_into_a_frame():
    frame = encode_reply(Dialect.FRAMED, [render_value(error_reply("x" * 500), Dialect.FRAMED)])
    assert len(frame) == 8 + MAX_FRAMED_REPLY_LENGTH < 128
    assert frame.endswith(b'..."')


def test_a_long_reply_that_is_no_error_is_refused_for_a_frame():
    with pytest.raises(ProtocolError, match="at most 119"):
        encode_reply(Dialect.FRAMED, ["[" + "1" * 200 + "]"])


def test_a_framed_reply_has_one_part():
    with pytest.raises(ProtocolError, match="one part"):
        encode_reply(Dialect.FRAMED, ["1", "2"])


def test_a_carriage_return_before_the_line_end_is_dropped():
    assert RequestDecoder().feed(b"get state\r\nget os\r\n") == ["get state", "get os"]


def test_bytes_that_are_not_ascii_are_shown_in_the_request():
    assert RequestDecoder().feed(b"get caf\xe9\n") == ["get caf\\xe9"]


@pytest.mark.parametrize(
    "data",
    [
        b"x" * 5000,
        b"x" * 5000 + b"\n",
        struct.pack(">II", 0xFFFFFF, 0),
        struct.pack(">II", 5000, 0),
        struct.pack(">II", 4, 1) + b"abcd",
        b"\x80",
        b"\x16\x03\x01",
    ],
)
def test_a_request_that_is_too_long_or_none_is_refused(data):
    with pytest.raises(ProtocolError):
        RequestDecoder().feed(data)


def test_a_megabyte_in_pieces_is_refused_before_it_is_stored():
    decoder = RequestDecoder()
    for _ in range(4):
        assert decoder.feed(b"x" * 1000) == []
    with pytest.raises(ProtocolError, match="4096"):
        decoder.feed(b"x" * 1000)


def test_a_reply_that_is_not_ascii_is_refused():
    with pytest.raises(ProtocolError, match="ASCII"):
        ReplyDecoder(Dialect.TEXT).feed(b"caf\xe9;\n")


@dialects
@pytest.mark.parametrize("text", ["café", "get state\nset state off"])
def test_a_request_must_be_one_line_of_ascii(dialect, text):
    with pytest.raises(ProtocolError):
        encode_request(dialect, text)
