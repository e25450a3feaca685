"""The protobuf wire format, as far as our messages need it. Standard library only."""

import struct
from array import array
from collections.abc import Iterable

VARINT = 0
FIXED64 = 1
LENGTH_DELIMITED = 2
FIXED32 = 5

_DOUBLE = struct.Struct("<d")


def encode_varint(value: int) -> bytes:
    """Base-128 form of a value >= 0."""
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)


def encode_tag(number: int, wire_type: int) -> bytes:
    """Tag of a field: one byte up to number 15, two from there to 2047."""
    return encode_varint(number << 3 | wire_type)


def encode_delimited(number: int, content: bytes) -> bytes:
    """A length-delimited field: sub-message, string, bytes or packed list."""
    return encode_tag(number, LENGTH_DELIMITED) + encode_varint(len(content)) + content


def encode_text(number: int, text: str) -> bytes:
    """A string field."""
    return encode_delimited(number, text.encode())


def encode_integer(number: int, value: int) -> bytes:
    """A varint field (int32, int64, enum) of a value >= 0."""
    return encode_tag(number, VARINT) + encode_varint(value)


def encode_packed_varints(number: int, values: Iterable[int]) -> bytes:
    """A packed ``repeated int32`` field of values >= 0."""
    return encode_delimited(number, b"".join(map(encode_varint, values)))


def pack_doubles(values: Iterable[float]) -> bytes:
    """Content of a packed ``repeated double``, little endian."""
    doubles = array("d", values)
    if struct.pack("=d", 1.0) != _DOUBLE.pack(1.0):  # pragma: no cover - big-endian hosts
        doubles.byteswap()
    return doubles.tobytes()
