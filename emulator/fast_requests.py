"""Requests at the loop's rate: the same commands in every cycle, only the numbers change.

What stands outside the brackets of a text request decides what is to be done; for the requests that
programs repeat (measurements, and the position, velocity or force of objects) that is worked out once and
kept. A plan does nothing that the commands one by one would not do: where anything is unusual it declines,
and they are carried out the ordinary way, which also words the refusals.
"""

from collections.abc import Callable, Mapping
from operator import itemgetter
from struct import Struct

from emulator.device import EmulatedDevice
from emulator.layout import E_BIAS, E_POSITION, E_SIZE, E_VELOCITY
from hm_driver.errors import ProtocolError
from hm_driver.protocol.commands import GetQuantity, SetParameter, format_value, parse_command
from hm_driver.protocol.vocabulary import Value

Plan = Callable[[list[str]], str | None]
"""Takes what stands in the brackets, with the closing one; returns the reply, or None to decline."""

HOT_PARAMETERS = {"pos": E_POSITION, "vel": E_VELOCITY, "force": E_BIAS}
"""Vectors that programs set in every cycle, with their place in an object's row."""

_VECTOR = Struct("3d")
_Setter = tuple[int, float, float]


def split_brackets(request: str) -> tuple[tuple[str, ...], list[str]]:
    """What stands outside the brackets of a request, and what stands in them with the closing one."""
    pieces = request.replace("]", "][").split("[")
    return tuple(pieces[::2]), pieces[1::2]


def plan_request(
    outside: tuple[str, ...],
    device: EmulatedDevice,
    vectors: Mapping[str, int],
    words: Mapping[str, Callable[[], Value]],
) -> Plan | None:
    """Work out how to carry out all requests that differ in numbers alone; None where that is not possible.

    Args:
        outside: What stands outside the brackets.
        device: What the commands act on.
        vectors: Index in the outputs of each vector that can be asked for.
        words: A function for everything else that can be asked for.
    """
    printed: list[str] = []
    indices: list[int] = []
    readers: list[Callable[[], Value]] = []
    setters: list[_Setter] = []
    parts = "[0,0,0]".join(outside).split(";")
    if not parts[-1].strip():
        del parts[-1]
    for part in parts:
        try:
            command = parse_command(part)
            match command:
                case GetQuantity(name) if name in vectors:
                    printed.append("[%g,%g,%g]")
                    indices += range(vectors[name], vectors[name] + 3)
                case GetQuantity(name):
                    printed.append("%%s")
                    readers.append(words[name])
                case SetParameter(owner, name, _) if name in HOT_PARAMETERS:
                    entry = device.find(owner)
                    description = entry.type.parameter(name)
                    printed.append(description.reply)
                    offset = 8 * (entry.slot * E_SIZE + HOT_PARAMETERS[name])
                    setters.append((offset, description.low, description.high))
                case _:
                    return None
        except ProtocolError:
            return None
    if len(setters) != len(outside) - 1:
        return None
    return _compose(";".join(printed) + ";\n", indices, readers, setters, device)


def _compose(
    template: str,
    indices: list[int],
    readers: list[Callable[[], Value]],
    setters: list[_Setter],
    device: EmulatedDevice,
) -> Plan:
    outputs, rows = device.outputs, device.effect_rows
    pack = _VECTOR.pack_into
    select = itemgetter(*indices) if indices else None

    def run(brackets: list[str]) -> str | None:
        try:
            for (offset, low, high), text in zip(setters, brackets, strict=True):
                a, b, c = text[:-1].split(",")
                x, y, z = float(a), float(b), float(c)
                if not (low <= x <= high and low <= y <= high and low <= z <= high):
                    return None
                if "_" in text or text[-1] != "]":
                    return None
                pack(rows, offset, x, y, z)
        except ValueError:
            return None
        reply = template % (select(outputs) if select is not None else ())
        if readers:
            return reply % tuple([format_value(read()) for read in readers])
        return reply

    return run
