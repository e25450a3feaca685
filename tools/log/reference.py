"""Our topics and columns in Markdown: ``python -m tools.log.reference`` prints them for docs/logs.md."""

import sys
from collections.abc import Iterator

from hm_driver.recording.derivation import ArmDeriver
from hm_driver.recording.messages import Field, FixedMessage, Kind, VariableMessage
from hm_driver.recording.schemas import DEVICE_CHANNELS, Channel
from teaching.messages import CHANNELS
from tools.run.scene import SCENE_CHANNEL

OWN = (*DEVICE_CHANNELS, *CHANNELS)
"""Channels of messages of our own."""
FOR_VIEWERS = (*ArmDeriver.channels, SCENE_CHANNEL)
"""Channels that are made of these for viewers."""


def tables() -> str:
    """A heading and a table for each topic of our own, and a table of those for viewers."""
    return "\n".join(_lines()) + "\n"


def _lines() -> Iterator[str]:
    for channel in OWN:
        yield from _topic(channel)
    yield from (
        "### For viewers",
        "",
        "Made by the recorder of the topics above, at up to 50 Hz.",
        "",
        "| topic | message |",
        "| --- | --- |",
    )
    for channel in FOR_VIEWERS:
        yield f"| `{channel.topic}` | `{channel.message.full_name}` |"


def _topic(channel: Channel) -> Iterator[str]:
    message = channel.message
    if not isinstance(message, FixedMessage | VariableMessage):
        return
    yield f"### `{channel.topic}`"
    yield ""
    yield f"`{message.full_name}`: {message.doc}"
    yield ""
    yield "| column | type | unit | meaning |"
    yield "| --- | --- | --- | --- |"
    for field in message.fields:
        yield f"| {_columns(field)} | {_type(field)} | {field.unit} | {field.doc} |"
    yield ""


def _columns(field: Field) -> str:
    return f"`{field.name}.x`, `.y`, `.z`" if field.kind is Kind.VECTOR3 else f"`{field.name}`"


def _type(field: Field) -> str:
    names = {
        Kind.VECTOR3: "float64",
        Kind.DOUBLE: "float64",
        Kind.FLOAT: "float32",
        Kind.FIXED64: "uint64",
        Kind.SFIXED64: "int64",
        Kind.FIXED32: "uint32",
        Kind.SFIXED32: "int32",
        Kind.TEXT: "text",
        Kind.DOUBLES: "list of float64",
    }
    return names.get(field.kind, field.kind.value)


if __name__ == "__main__":
    sys.stdout.write(tables())
