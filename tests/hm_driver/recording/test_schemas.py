import pickle
import subprocess
import sys

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from hm_driver.recording.schemas import (
    DEVICE_CHANNELS,
    DEVICE_STATE,
    EVENT,
    LOOP_BUNDLE,
    Bundle,
    Channel,
    Field,
    FixedMessage,
    Kind,
    VariableMessage,
)

STATE_VALUES = (7, 1_800_000_000_000_000_001, 0.1, 0.2, 0.3, 1.0, 2.0, 3.0, -1.0, -2.0, -3.0)


def decode(message, data):
    files = descriptor_pb2.FileDescriptorSet.FromString(message.file_descriptor_set())
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    descriptor = pool.FindMessageTypeByName(f"hapticmaster.{message.name}")
    return message_factory.GetMessageClass(descriptor).FromString(data)


def test_protobuf_reads_a_fixed_message_as_it_was_packed():
    decoded = decode(DEVICE_STATE, DEVICE_STATE.pack(*STATE_VALUES))
    assert decoded.sequence == 7
    assert decoded.time_ns == 1_800_000_000_000_000_001
    assert (decoded.measured_position.x, decoded.measured_position.z) == (0.1, 0.3)
    assert decoded.measured_force.y == -2.0


def test_every_message_of_a_fixed_type_has_the_same_size_zeros_included():
    assert len(DEVICE_STATE.pack(*[0] * 11)) == len(DEVICE_STATE.pack(*STATE_VALUES)) == DEVICE_STATE.size


def test_packing_into_a_buffer_gives_the_same_bytes_as_packing():
    buffer = bytearray(DEVICE_STATE.size + 10)
    DEVICE_STATE.pack_into(buffer, 5, *STATE_VALUES)
    assert bytes(buffer[5:-5]) == DEVICE_STATE.pack(*STATE_VALUES)
    assert bytes(buffer[:5]) == bytes(buffer[-5:]) == bytes(5)


def test_fields_above_number_15_take_a_tag_of_two_bytes_and_every_scalar_kind_is_understood():
    kinds = (Kind.FLOAT, Kind.FIXED32, Kind.SFIXED32, Kind.BOOL, Kind.FIXED64, Kind.SFIXED64)
    many = tuple(Field(f"f{number}", Kind.DOUBLE, "A number") for number in range(14))
    fields = (
        *many,
        *(Field(kind.value, kind, "A number") for kind in kinds),
        Field("v", Kind.VECTOR3, "A vector"),
    )
    message = FixedMessage("Wide", "Many fields.", fields)
    decoded = decode(message, message.pack(*range(14), 0.5, 7, -7, 1, 2**64 - 1, -(2**63), 1.0, 2.0, 3.0))
    assert [getattr(decoded, f"f{number}") for number in range(14)] == list(range(14))
    assert (decoded.float, decoded.fixed32, decoded.sfixed32, decoded.bool) == (0.5, 7, -7, True)
    assert (decoded.fixed64, decoded.sfixed64) == (2**64 - 1, -(2**63))
    assert (decoded.v.x, decoded.v.y, decoded.v.z) == (1.0, 2.0, 3.0)


def test_the_schema_keeps_the_sentence_and_the_unit_of_each_field():
    files = descriptor_pb2.FileDescriptorSet.FromString(DEVICE_STATE.file_descriptor_set())
    file = files.file[-1]
    comments = {tuple(place.path): place.leading_comments for place in file.source_code_info.location}
    index = [field.name for field in file.message_type[0].field].index("measured_force")
    assert comments[4, 0, 2, index].strip() == "Force of the hand on the end effector [N]."


def test_protobuf_reads_a_variable_message_with_text_and_lists():
    decoded = decode(EVENT, EVENT.pack(3, 12, 2, "update", "The skill was learned – ok", [0.5, 1.5]))
    assert (decoded.sequence, decoded.time_ns, decoded.level, decoded.name) == (3, 12, 2, "update")
    assert decoded.text == "The skill was learned – ok"
    assert list(decoded.values) == [0.5, 1.5]


def test_a_variable_message_may_hold_vectors_and_bytes():
    fields = (Field("v", Kind.VECTOR3, "Vector", "m"), Field("raw", Kind.BYTES, "Bytes"))
    message = VariableMessage("Mixed", "Mixed.", fields)
    decoded = decode(message, message.pack((1.0, 2.0, 3.0), b"\x00\xff"))
    assert (decoded.v.y, decoded.raw) == (2.0, b"\x00\xff")


def test_a_wrong_number_or_type_of_values_is_refused():
    with pytest.raises(ValueError, match="takes 6 values"):
        EVENT.pack(1, 2)
    with pytest.raises(TypeError, match="field name takes a string"):
        EVENT.pack(1, 2, 3, 4, "text", [])
    with pytest.raises(ValueError, match="extended slice"):
        DEVICE_STATE.pack(1, 2)


def test_a_bundle_is_its_messages_one_behind_the_other():
    values = [(1,) * len(channel.message.columns) for channel in LOOP_BUNDLE.channels]
    whole = [value for part in values for value in part]
    packed = LOOP_BUNDLE.pack(*whole)
    buffer = bytearray(LOOP_BUNDLE.size)
    LOOP_BUNDLE.pack_into(buffer, 0, *whole)
    assert packed == bytes(buffer)
    for channel, (channel_id, start, end) in zip(LOOP_BUNDLE.channels, LOOP_BUNDLE.slices, strict=True):
        assert channel.id == channel_id
        assert decode(channel.message, packed[start:end]).sequence == 1


def test_messages_that_cannot_be_written_are_refused_when_they_are_described():
    with pytest.raises(ValueError, match="no fixed width"):
        FixedMessage("Bad", "Bad.", (Field("text", Kind.TEXT, "Text"),))
    with pytest.raises(ValueError, match="named twice"):
        VariableMessage("Bad", "Bad.", (Field("a", Kind.TEXT, "Text"), Field("a", Kind.TEXT, "Text")))
    with pytest.raises(ValueError, match="has no fields"):
        FixedMessage("Bad", "Bad.", ())
    with pytest.raises(ValueError, match="no fixed width"):
        Bundle(99, (Channel(4, "/events", EVENT),))


def test_channels_and_bundles_of_the_driver_have_numbers_of_their_own():
    numbers = [channel.id for channel in DEVICE_CHANNELS] + [LOOP_BUNDLE.id]
    assert len(set(numbers)) == len(numbers)


def test_the_loop_process_gets_schemas_and_ring_without_numpy_or_protobuf():
    code = (
        "import sys; import hm_driver.recording.schemas, hm_driver.recording.ring; "
        "heavy = {'numpy', 'numba', 'google.protobuf', 'mcap'} & set(sys.modules); "
        "sys.exit(repr(heavy) if heavy else 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_messages_and_bundles_can_be_handed_to_another_process():
    copy = pickle.loads(pickle.dumps(LOOP_BUNDLE))  # noqa: S301 - our own bytes
    values = [1] * 2 + [0.5] * 9 + [1] * 2 + [0.5] * 17 + [1] * 7 + [0.5, 1]
    assert copy.pack(*values) == LOOP_BUNDLE.pack(*values)
    assert copy.slices == LOOP_BUNDLE.slices
