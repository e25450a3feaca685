"""Messages of other packages, of which a generated protobuf class exists: those that viewers know."""

from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any, TypeAlias

from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet

Draft: TypeAlias = Any
"""A message of a generated class, or the class: its attributes are made at run time."""


@dataclass(frozen=True)
class ForeignMessage:
    """A message by its generated class, which is imported when it is first needed.

    Args:
        full_name: Name of the message with its package, as ``foxglove.PoseInFrame``.
        module: Module of the generated class.
    """

    full_name: str
    module: str

    @property
    def name(self) -> str:
        """Name without the package."""
        return self.full_name.rpartition(".")[2]

    @cached_property
    def message_class(self) -> Draft:
        """The generated class."""
        return getattr(import_module(self.module), self.name)

    def file_descriptor_set(self) -> bytes:
        """Serialised ``google.protobuf.FileDescriptorSet`` with everything that the message is made of."""
        files: dict[str, FileDescriptor] = {}
        _collect(self.message_class.DESCRIPTOR.file, files)
        wanted = FileDescriptorSet()
        for file in files.values():
            file.CopyToProto(wanted.file.add())
        return wanted.SerializeToString()


def foxglove(name: str) -> ForeignMessage:
    """A message of the ``foxglove`` package by its name."""
    return ForeignMessage(f"foxglove.{name}", f"foxglove_schemas_protobuf.{name}_pb2")


def _collect(file: FileDescriptor, files: dict[str, FileDescriptor]) -> None:
    for imported in file.dependencies:
        _collect(imported, files)
    files.setdefault(file.name, file)
