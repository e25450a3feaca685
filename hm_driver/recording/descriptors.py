"""Protobuf descriptors written by hand: a schema is made without importing protobuf. Standard library only.

Field numbers are those of ``google/protobuf/descriptor.proto``.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hm_driver.recording import wire

_LABEL_OPTIONAL = 1
_LABEL_REPEATED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldDescriptor:
    """What a ``FieldDescriptorProto`` says of one field."""

    name: str
    """Name of the field."""
    comment: str
    """Sentence that stands above the field in a ``.proto`` file."""
    type: int
    """Number of the type in ``FieldDescriptorProto.Type``."""
    type_name: str = ""
    """Full name of a sub-message, with a leading dot."""
    is_repeated: bool = False
    """Whether it is a list."""

    def encode(self, number: int) -> bytes:
        """Serialised ``FieldDescriptorProto``."""
        return (
            wire.encode_text(1, self.name)
            + wire.encode_integer(3, number)
            + wire.encode_integer(4, _LABEL_REPEATED if self.is_repeated else _LABEL_OPTIONAL)
            + wire.encode_integer(5, self.type)
            + (wire.encode_text(6, self.type_name) if self.type_name else b"")
            + wire.encode_text(10, self.name)
        )


def file_name(package: str, message: str) -> str:
    """Name of the ``.proto`` file of a message."""
    return f"{package}/{message}.proto"


def encode_file(
    package: str,
    message: str,
    comment: str,
    fields: Sequence[FieldDescriptor],
    *,
    imports: Iterable[str] = (),
) -> bytes:
    """Serialised ``FileDescriptorProto`` of one message; imports are messages of the same package."""
    descriptor = wire.encode_text(1, message) + b"".join(
        wire.encode_delimited(2, field.encode(number)) for number, field in enumerate(fields, start=1)
    )
    comments = _location((4, 0), 0, comment) + b"".join(
        _location((4, 0, 2, index), index + 1, field.comment) for index, field in enumerate(fields)
    )
    return (
        wire.encode_text(1, file_name(package, message))
        + wire.encode_text(2, package)
        + b"".join(wire.encode_text(3, file_name(package, name)) for name in imports)
        + wire.encode_delimited(4, descriptor)
        + wire.encode_delimited(9, comments)
        + wire.encode_text(12, "proto3")
    )


def encode_set(files: Iterable[bytes]) -> bytes:
    """Serialised ``FileDescriptorSet``; a file stands behind those that it imports."""
    return b"".join(wire.encode_delimited(1, file) for file in files)


def _location(path: Sequence[int], line: int, comment: str) -> bytes:
    return wire.encode_delimited(
        1,
        wire.encode_packed_varints(1, path)
        + wire.encode_packed_varints(2, (line, 0, 1))
        + wire.encode_text(3, f" {comment}\n"),
    )
