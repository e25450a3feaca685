"""Protobuf messages that are cheap to write, described as data. Standard library only.

A `FixedMessage` has fields of fixed width alone. Protobuf then gives every message of the type the same
length, with the same tag bytes in the same places, and writing one is a single ``struct`` call: the loop
process packs straight into shared memory, without importing protobuf. A `VariableMessage` may hold text and
lists, and is written field by field. Both are ordinary proto3 messages to every reader.

Fields are numbered from 1 in their order. A schema grows by appending fields; none is ever removed, reordered
or given another type, so that older logs open.

Example:
    >>> from hm_driver.recording.messages import Field, FixedMessage, Kind
    >>> message = FixedMessage("Sample", "One sample.", (Field("depth", Kind.DOUBLE, "Depth", "m"),))
    >>> message.pack(0.5).hex()
    '09000000000000e03f'
"""

import struct
from collections.abc import Iterable, Sequence
from enum import Enum
from typing import Any, Protocol, TypeAlias

from hm_driver.recording import descriptors, wire

PACKAGE = "hapticmaster"
VECTOR3 = "Vector3"
VECTOR_AXES = ("x", "y", "z")

Value: TypeAlias = "float | str | bytes | Iterable[float]"


class Kind(Enum):
    """What a field holds."""

    DOUBLE = "double"
    """A 64-bit float."""
    FLOAT = "float"
    """A 32-bit float."""
    FIXED64 = "fixed64"
    """An integer from 0 to 2^64 - 1."""
    SFIXED64 = "sfixed64"
    """A signed 64-bit integer."""
    FIXED32 = "fixed32"
    """An integer from 0 to 2^32 - 1."""
    SFIXED32 = "sfixed32"
    """A signed 32-bit integer."""
    BOOL = "bool"
    """True or false; always written, so that its width is fixed."""
    VECTOR3 = "vector3"
    """A sub-message of three doubles x, y, z."""
    TEXT = "string"
    """Text (variable messages only)."""
    BYTES = "bytes"
    """Bytes (variable messages only)."""
    DOUBLES = "repeated double"
    """A list of doubles (variable messages only)."""


_SCALARS = {
    Kind.DOUBLE: ("d", wire.FIXED64),
    Kind.FLOAT: ("f", wire.FIXED32),
    Kind.FIXED64: ("Q", wire.FIXED64),
    Kind.SFIXED64: ("q", wire.FIXED64),
    Kind.FIXED32: ("I", wire.FIXED32),
    Kind.SFIXED32: ("i", wire.FIXED32),
    Kind.BOOL: ("?", wire.VARINT),
}

_DESCRIPTOR_TYPES = {
    Kind.DOUBLE: 1,
    Kind.FLOAT: 2,
    Kind.FIXED64: 6,
    Kind.FIXED32: 7,
    Kind.BOOL: 8,
    Kind.TEXT: 9,
    Kind.VECTOR3: 11,
    Kind.BYTES: 12,
    Kind.SFIXED32: 15,
    Kind.SFIXED64: 16,
    Kind.DOUBLES: 1,
}


class Field:
    """One field of a message.

    Args:
        name: Name in lower case with underscores.
        kind: What it holds.
        doc: One sentence without the full stop; it is kept in the log's schema.
        unit: SI unit, or empty for a number without one.
    """

    __slots__ = ("doc", "kind", "name", "unit")

    def __init__(self, name: str, kind: Kind, doc: str, unit: str = "") -> None:
        self.name = name
        self.kind = kind
        self.doc = doc
        self.unit = unit

    @property
    def comment(self) -> str:
        """The sentence that goes into the schema, with the unit in brackets."""
        return f"{self.doc} [{self.unit}]." if self.unit else f"{self.doc}."

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that a reader makes of the field."""
        if self.kind is Kind.VECTOR3:
            return tuple(f"{self.name}.{axis}" for axis in VECTOR_AXES)
        return (self.name,)


class Message(Protocol):
    """What the recorder and the reader need to know of a message."""

    @property
    def full_name(self) -> str:
        """Its name with the package, as in the schema."""

    def file_descriptor_set(self) -> bytes:
        """Serialised ``google.protobuf.FileDescriptorSet``: the schema that goes into a log."""


def _columns(fields: Iterable[Field]) -> tuple[str, ...]:
    return tuple(column for field in fields for column in field.columns)


def _descriptor(name: str, doc: str, fields: Sequence[Field]) -> bytes:
    described = tuple(
        descriptors.FieldDescriptor(
            name=field.name,
            comment=field.comment,
            type=_DESCRIPTOR_TYPES[field.kind],
            type_name=f".{PACKAGE}.{VECTOR3}" if field.kind is Kind.VECTOR3 else "",
            is_repeated=field.kind is Kind.DOUBLES,
        )
        for field in fields
    )
    if any(field.kind is Kind.VECTOR3 for field in fields):
        files = [_vector_file(), descriptors.encode_file(PACKAGE, name, doc, described, imports=(VECTOR3,))]
    else:
        files = [descriptors.encode_file(PACKAGE, name, doc, described)]
    return descriptors.encode_set(files)


def _vector_file() -> bytes:
    double = _DESCRIPTOR_TYPES[Kind.DOUBLE]
    axes = tuple(
        descriptors.FieldDescriptor(name=axis, comment=f"Component along {axis}.", type=double)
        for axis in VECTOR_AXES
    )
    return descriptors.encode_file(PACKAGE, VECTOR3, "Three components along the axes of a frame.", axes)


def _check_names(name: str, fields: Sequence[Field]) -> None:
    names = [field.name for field in fields]
    twice = {one for one in names if names.count(one) > 1}
    if twice:
        raise ValueError(f"message {name}: fields named twice: {sorted(twice)}")
    if not names:
        raise ValueError(f"message {name} has no fields")


class FixedMessage:
    """A message whose fields all have a fixed width.

    Args:
        name: Name of the message in package ``hapticmaster``.
        doc: What it is, for the schema.
        fields: Its fields; every kind but TEXT, BYTES and DOUBLES.

    Raises:
        ValueError: for a field of variable width, a name used twice, or no field.
    """

    def __init__(self, name: str, doc: str, fields: Iterable[Field]) -> None:
        self.name = name
        self.doc = doc
        self.fields = tuple(fields)
        _check_names(name, self.fields)
        self.layout = tuple(self._layout())
        """Constant bytes before each value, and the struct code of the value."""
        self.columns = _columns(self.fields)
        self._struct = struct.Struct("<" + "".join(f"{len(tag)}s{code}" for tag, code in self.layout))
        self._template: list[object] = [part for tag, _ in self.layout for part in (tag, 0)]
        self._values = struct.Struct("<" + "".join(f"{len(tag)}x{code}" for tag, code in self.layout))
        self.size = self._struct.size

    @property
    def full_name(self) -> str:
        """Its name with the package."""
        return f"{PACKAGE}.{self.name}"

    def __reduce__(self) -> tuple[type["FixedMessage"], tuple[str, str, tuple[Field, ...]]]:
        return FixedMessage, (self.name, self.doc, self.fields)

    def _layout(self) -> Iterable[tuple[bytes, str]]:
        axes = [wire.encode_tag(number, wire.FIXED64) for number in (1, 2, 3)]
        for number, field in enumerate(self.fields, start=1):
            if field.kind is Kind.VECTOR3:
                length = wire.encode_varint(3 * (1 + 8))
                yield wire.encode_tag(number, wire.LENGTH_DELIMITED) + length + axes[0], "d"
                yield axes[1], "d"
                yield axes[2], "d"
            elif field.kind in _SCALARS:
                code, wire_type = _SCALARS[field.kind]
                yield wire.encode_tag(number, wire_type), code
            else:
                raise ValueError(
                    f"message {self.name}: field {field.name} ({field.kind.value}) has no fixed width"
                )

    def pack(self, *values: Value) -> bytes:
        """Wire form of the values, one per column.

        Raises:
            struct.error: for a value of the wrong type or outside its range.
            ValueError: for a wrong number of values.
        """
        parts = self._template[:]
        parts[1::2] = values
        return self._struct.pack(*parts)

    def unpack(self, payload: bytes) -> tuple[Any, ...]:
        """The values of a message that `pack` made, one per column.

        Raises:
            struct.error: for a payload of another size.
        """
        return self._values.unpack(payload)

    def pack_into(self, buffer: bytearray | memoryview, offset: int, *values: float) -> None:
        """Write the wire form into ``buffer[offset : offset + size]``; raises as `pack` does."""
        parts = self._template[:]
        parts[1::2] = values
        self._struct.pack_into(buffer, offset, *parts)

    def file_descriptor_set(self) -> bytes:
        """Serialised ``google.protobuf.FileDescriptorSet`` with the fields' comments and units."""
        return _descriptor(self.name, self.doc, self.fields)


class VariableMessage:
    """A message that may hold text, bytes and lists; written field by field.

    Args:
        name: Name of the message in package ``hapticmaster``.
        doc: What it is, for the schema.
        fields: Its fields, of any kind.

    Raises:
        ValueError: for a name used twice, or no field.
    """

    def __init__(self, name: str, doc: str, fields: Iterable[Field]) -> None:
        self.name = name
        self.doc = doc
        self.fields = tuple(fields)
        _check_names(name, self.fields)
        self.columns = _columns(self.fields)

    @property
    def full_name(self) -> str:
        """Its name with the package."""
        return f"{PACKAGE}.{self.name}"

    def pack(self, *values: Value) -> bytes:
        """Wire form of the values, one per field; a VECTOR3 takes a sequence of three.

        Raises:
            struct.error: for a number outside its range.
            TypeError: for a value of the wrong type.
            ValueError: for a wrong number of values.
        """
        if len(values) != len(self.fields):
            names = ", ".join(field.name for field in self.fields)
            raise ValueError(
                f"message {self.name} takes {len(self.fields)} values ({names}), got {len(values)}"
            )
        return b"".join(
            _encode(number, field, value)
            for number, (field, value) in enumerate(zip(self.fields, values, strict=True), start=1)
        )

    def file_descriptor_set(self) -> bytes:
        """Serialised ``google.protobuf.FileDescriptorSet`` with the fields' comments and units."""
        return _descriptor(self.name, self.doc, self.fields)


def _encode(number: int, field: Field, value: Value) -> bytes:
    if field.kind in _SCALARS:
        code, wire_type = _SCALARS[field.kind]
        return wire.encode_tag(number, wire_type) + struct.pack("<" + code, value)
    if field.kind is Kind.TEXT and isinstance(value, str):
        return wire.encode_text(number, value)
    if field.kind is Kind.BYTES and isinstance(value, bytes):
        return wire.encode_delimited(number, value)
    if isinstance(value, (str, bytes, int, float)):
        raise TypeError(f"field {field.name} takes a {field.kind.value}, got {value!r}")
    if field.kind is Kind.DOUBLES:
        return wire.encode_delimited(number, wire.pack_doubles(value))
    x, y, z = value
    axes = (
        wire.encode_tag(axis, wire.FIXED64) + struct.pack("<d", part)
        for axis, part in enumerate((x, y, z), start=1)
    )
    return wire.encode_delimited(number, b"".join(axes))
