import re
from pathlib import Path

import haptic_master.haptic_master
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hm_driver.errors import ProtocolError
from hm_driver.protocol import vocabulary as v
from hm_driver.protocol.framing import MAX_FRAMED_REPLY_LENGTH, Dialect, encode_reply, render_value

ALL_PARAMETERS = [
    *v.QUANTITIES.values(),
    *(parameter for kind in v.OBJECT_TYPES.values() for parameter in kind.parameters.values()),
]
ALL_REPLIES = {
    *(parameter.reply for parameter in ALL_PARAMETERS if parameter.reply),
    *(v.created_reply(name, "{self.name}") for name in v.OBJECT_TYPES),
    v.REMOVED,
    v.EFFECT_ENABLED,
    v.EFFECT_DISABLED,
    v.FORCE_SENSOR_CALIBRATED,
}


def texts_of_the_published_client():
    for source in Path(haptic_master.haptic_master.__file__).parent.glob("*.py"):
        for text in re.findall(r"return f?'(.*)' in self\.", source.read_text(encoding="utf-8")):
            yield text.replace("\\'", "'").replace("{device_state}", "{}")


@pytest.mark.parametrize("text", sorted(set(texts_of_the_published_client())))
def test_every_text_that_the_published_client_tests_for_is_a_reply(text):
    assert any(text in reply for reply in ALL_REPLIES)


def test_the_published_client_was_really_read():
    assert len(set(texts_of_the_published_client())) > 45


@pytest.mark.parametrize("word", ["stop", "position", "init"])
def test_the_published_client_reads_states_from_frames(word):
    client = haptic_master.haptic_master.HapticMaster("nowhere", 0)
    frame = encode_reply(Dialect.FRAMED, [render_value(word, Dialect.FRAMED)])
    assert client._haptic_master_response(frame) == word
    client.sock.close()


@pytest.mark.parametrize("parameter", ALL_PARAMETERS, ids=lambda parameter: parameter.name)
def test_every_default_is_acceptable(parameter):
    if parameter.name != "os":
        assert parameter.check(parameter.default) == parameter.default


@pytest.mark.parametrize("parameter", ALL_PARAMETERS, ids=lambda parameter: parameter.name)
def test_every_refusal_fits_into_a_frame_once_shortened(parameter):
    with pytest.raises(ProtocolError) as caught:
        parameter.check(("x" * 500,))
    reply = render_value(v.error_reply(str(caught.value)), Dialect.FRAMED)
    assert len(encode_reply(Dialect.FRAMED, [reply])) <= 8 + MAX_FRAMED_REPLY_LENGTH < 128


def test_the_longest_creation_reply_fits_into_a_frame():
    name = "n" * v.MAX_NAME_LENGTH
    for kind in v.OBJECT_TYPES:
        encode_reply(Dialect.FRAMED, [render_value(v.created_reply(kind, name), Dialect.FRAMED)])


def test_every_object_has_position_velocity_and_attitude():
    for kind in v.OBJECT_TYPES.values():
        assert {"pos", "vel", "att"} <= set(kind.parameters)


def test_a_direction_is_normalised():
    assert v.OBJECT_TYPES["spring"].parameter("direction").check((0.0, 3.0, 4.0)) == (0.0, 0.6, 0.8)


def test_a_quaternion_is_normalised():
    assert v.OBJECT_TYPES["block"].parameter("att").check((0.0, 0.0, 0.0, 2.0)) == (0.0, 0.0, 0.0, 1.0)


def test_a_zero_direction_unsets_a_springs_and_is_refused_as_a_normal():
    zero = (0.0, 0.0, 0.0)
    assert v.OBJECT_TYPES["spring"].parameter("direction").check(zero) == zero
    with pytest.raises(ProtocolError, match="no direction"):
        v.OBJECT_TYPES["flatplane"].parameter("normal").check(zero)


@pytest.mark.parametrize(
    ("type_name", "parameter", "value", "said"),
    [
        ("spring", "stiffness", -1.0, "0 to 100000 N/m"),
        ("spring", "stiffness", True, "a number"),
        ("spring", "stiffness", (1.0, 2.0, 3.0), "a number"),
        ("spring", "dampglobal", 1.0, "true or false"),
        ("damper", "dampcoef", 3.0, "a vector"),
        ("damper", "dampcoef", (1.0, 2.0, -3.0), "0 to 10000"),
        ("block", "att", (0.0, 0.0, 1.0), "quaternion"),
        ("sphere", "radius", 0.0, "0.0001 to 10 m"),
        ("spring", "pos", (float("nan"), 0.0, 0.0), "a vector"),
    ],
)
def test_a_wrong_value_is_refused_with_what_would_be_accepted(type_name, parameter, value, said):
    with pytest.raises(ProtocolError, match=said):
        v.OBJECT_TYPES[type_name].parameter(parameter).check(value)


def test_an_unknown_parameter_lists_those_there_are():
    with pytest.raises(ProtocolError, match="dampcoef pos vel att"):
        v.OBJECT_TYPES["damper"].parameter("stiffness")


@given(st.text())
def test_an_error_text_cannot_end_or_quote_a_reply(reason):
    text = v.error_reply(reason)
    assert text.startswith(v.ERROR_MARK)
    assert text.isascii()
    assert not set(text) & set(';"\n\r')
