"""From the bytes of protobuf messages to numpy columns, by the schema that the log itself carries.

Messages of fixed width are decoded all at once: their bytes are seen as one structured array, after a check
that every tag byte is where the schema puts it. All others are parsed one by one.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any, TypeAlias

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from hm_driver.errors import RecordingError
from hm_driver.recording import wire

Columns: TypeAlias = dict[str, NDArray[Any]]

_FIXED = {
    FieldDescriptor.TYPE_DOUBLE: ("<f8", wire.FIXED64),
    FieldDescriptor.TYPE_FLOAT: ("<f4", wire.FIXED32),
    FieldDescriptor.TYPE_FIXED64: ("<u8", wire.FIXED64),
    FieldDescriptor.TYPE_SFIXED64: ("<i8", wire.FIXED64),
    FieldDescriptor.TYPE_FIXED32: ("<u4", wire.FIXED32),
    FieldDescriptor.TYPE_SFIXED32: ("<i4", wire.FIXED32),
    FieldDescriptor.TYPE_BOOL: ("?", wire.VARINT),
}

_DTYPES = {
    FieldDescriptor.CPPTYPE_DOUBLE: np.float64,
    FieldDescriptor.CPPTYPE_FLOAT: np.float32,
    FieldDescriptor.CPPTYPE_UINT64: np.uint64,
    FieldDescriptor.CPPTYPE_INT64: np.int64,
    FieldDescriptor.CPPTYPE_UINT32: np.uint32,
    FieldDescriptor.CPPTYPE_INT32: np.int32,
    FieldDescriptor.CPPTYPE_ENUM: np.int32,
    FieldDescriptor.CPPTYPE_BOOL: np.bool_,
}


class Decoder:
    """Decodes the messages of one schema.

    Args:
        name: Full name of the message.
        file_descriptor_set: The schema, as in the log.

    Raises:
        RecordingError: if the schema is damaged or does not hold the message.
    """

    def __init__(self, name: str, file_descriptor_set: bytes) -> None:
        try:
            files = descriptor_pb2.FileDescriptorSet.FromString(file_descriptor_set)
            pool = descriptor_pool.DescriptorPool()
            for file in files.file:
                pool.Add(file)
            self._descriptor: Descriptor = pool.FindMessageTypeByName(name)
        except (DecodeError, KeyError, TypeError, ValueError) as error:
            raise RecordingError(f"the schema of {name} is damaged: {error}") from error
        self.units = _units(files, name)
        """Unit of each column that has one."""
        self._getters = tuple(_getters(self._descriptor, "", lambda message: message))
        self.names = tuple(name for name, _, _ in self._getters)
        """Names of the columns; those of a sub-message have a dot."""
        self.kinds = dict(_kinds(self._descriptor, ""))
        """What each column holds: a numpy dtype such as ``float64``, or ``text`` or ``bytes``;
        of lists ``float64 list`` and so on, of lists of sub-messages ``message list``."""
        self._layout = _Layout.of(self._descriptor)

    def decode(
        self, payloads: NDArray[np.uint8] | Sequence[bytes], names: Collection[str] | None = None
    ) -> Columns:
        """Columns of the messages.

        Args:
            payloads: The messages: shape (n, size) where all have one size, else one by one.
            names: Columns that are wanted, others need not be there; all where None.

        Raises:
            RecordingError: if one cannot be parsed.
        """
        if isinstance(payloads, np.ndarray):
            if self._layout is not None:
                columns = self._layout.decode(payloads, names)
                if columns is not None:
                    return columns
            payloads = [row.tobytes() for row in payloads]
        return self._parse(payloads)

    def _parse(self, payloads: Sequence[bytes]) -> Columns:
        cls = message_factory.GetMessageClass(self._descriptor)
        try:
            messages = [cls.FromString(payload) for payload in payloads]
        except DecodeError as error:
            raise RecordingError(f"a message of {self._descriptor.full_name} is damaged: {error}") from error
        return {name: _array([get(one) for one in messages], dtype) for name, get, dtype in self._getters}


class _Layout:
    """Where the values of a message of fixed width stand."""

    def __init__(
        self, constants: list[tuple[int, int]], fields: list[tuple[str, str, int]], size: int
    ) -> None:
        self._places = np.array([place for place, _ in constants])
        self._bytes = np.array([byte for _, byte in constants], dtype=np.uint8)
        names, formats, offsets = (list(part) for part in zip(*fields, strict=True))
        self._dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})

    @classmethod
    def of(cls, descriptor: Descriptor) -> "_Layout | None":
        """The layout, or None where a field has no fixed width."""
        constants: list[tuple[int, int]] = []
        fields: list[tuple[str, str, int]] = []
        size = _lay_out(descriptor, "", 0, constants, fields)
        return cls(constants, fields, size) if size and fields else None

    def decode(self, payloads: NDArray[np.uint8], names: Collection[str] | None) -> Columns | None:
        """Columns of payloads of shape (n, size); None where they do not look as the schema says."""
        if payloads.shape[1] != self._dtype.itemsize:
            return None
        if not (payloads[:, self._places] == self._bytes).all():
            return None
        rows = np.ascontiguousarray(payloads).view(self._dtype)[:, 0]
        there = self._dtype.names or ()
        return {name: rows[name].copy() for name in there if names is None or name in names}


def _lay_out(
    descriptor: Descriptor,
    prefix: str,
    offset: int,
    constants: list[tuple[int, int]],
    fields: list[tuple[str, str, int]],
) -> int:
    """Append the constant bytes and values of a message that begins at offset; its end, or 0 if it varies."""
    for field in sorted(descriptor.fields, key=lambda one: one.number):
        if field.is_repeated:
            return 0
        if field.type in _FIXED:
            code, wire_type = _FIXED[field.type]
            tag = wire.encode_tag(field.number, wire_type)
            constants += ((offset + place, byte) for place, byte in enumerate(tag))
            offset += len(tag)
            fields.append((prefix + field.name, code, offset))
            offset += np.dtype(code).itemsize
        elif field.message_type is not None:
            inner_start = len(constants)
            tag = wire.encode_tag(field.number, wire.LENGTH_DELIMITED)
            body = offset + len(tag) + 1
            end = _lay_out(field.message_type, f"{prefix}{field.name}.", body, constants, fields)
            if not end or end - body > 0x7F:
                return 0
            head = enumerate((*tag, end - body))
            constants[inner_start:inner_start] = [(offset + place, byte) for place, byte in head]
            offset = end
        else:
            return 0
    return offset


Getter: TypeAlias = Callable[[Any], Any]


def _getters(descriptor: Descriptor, prefix: str, reach: Getter) -> Iterator[tuple[str, Getter, Any]]:
    """Name, access and dtype of each column of a message; sub-messages are flattened."""
    for field in sorted(descriptor.fields, key=lambda one: one.number):
        name = prefix + field.name
        get = _getter(reach, field.name)
        if field.is_repeated:
            yield name, _list_getter(get, _DTYPES.get(field.cpp_type)), object
        elif field.message_type is not None:
            yield from _getters(field.message_type, f"{name}.", get)
        else:
            yield name, get, _DTYPES.get(field.cpp_type, object)


def _kinds(descriptor: Descriptor, prefix: str) -> Iterator[tuple[str, str]]:
    """Name and kind of each column of a message."""
    for field in sorted(descriptor.fields, key=lambda one: one.number):
        name = prefix + field.name
        if field.message_type is not None and not field.is_repeated:
            yield from _kinds(field.message_type, f"{name}.")
            continue
        if field.message_type is not None:
            kind = "message"
        elif field.type == FieldDescriptor.TYPE_BYTES:
            kind = "bytes"
        else:
            dtype = _DTYPES.get(field.cpp_type)
            kind = "text" if dtype is None else np.dtype(dtype).name
        yield name, f"{kind} list" if field.is_repeated else kind


def _getter(reach: Getter, key: str) -> Getter:
    return lambda message: getattr(reach(message), key)


def _list_getter(get: Getter, dtype: Any) -> Getter:  # noqa: ANN401 - what numpy takes for a dtype
    def get_list(message: Any) -> Any:  # noqa: ANN401 - any message
        return list(get(message)) if dtype is None else np.array(get(message), dtype=dtype)

    return get_list


def _array(values: list[Any], dtype: Any) -> NDArray[Any]:  # noqa: ANN401 - what numpy takes for a dtype
    array = np.empty(len(values), dtype=dtype)
    for index, value in enumerate(values):
        array[index] = value
    return array


def _units(files: descriptor_pb2.FileDescriptorSet, name: str) -> dict[str, str]:
    """Units in brackets at the end of the fields' comments, by column."""
    units = {}
    for file in files.file:
        for place in file.source_code_info.location:
            if len(place.path) != 4 or (place.path[0], place.path[2]) != (4, 2):
                continue
            message = file.message_type[place.path[1]]
            comment = place.leading_comments.strip().rstrip(".")
            if f"{file.package}.{message.name}" == name and comment.endswith("]"):
                field = message.field[place.path[3]]
                unit = comment[comment.rindex("[") + 1 : -1]
                is_vector = field.type == FieldDescriptor.TYPE_MESSAGE
                units.update(
                    {f"{field.name}.{axis}" if is_vector else field.name: unit for axis in ("x", "y", "z")}
                )
    return units
