"""Commands that clients repeat in every cycle, for a kernel that answers whole requests.

A *phrase* is a command without its value: ``get measpos``, ``set spring_z pos``. The interpreter enters the
phrases of a request that it has carried out into the book; from then on `answer` carries out every request
that consists of these alone, whatever the numbers, the order and the choice. It does nothing that the
interpreter would not do: where anything is unusual it declines, and the interpreter has its say.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from emulator.compilation import Indices, Numbers, kernel, part
from emulator.device import EmulatedDevice
from emulator.layout import E_BIAS, E_MAX_FORCE, E_POSITION, E_SIZE, E_VELOCITY
from emulator.number_text import LONGEST_NUMBER, Text, read_number, write_number
from hm_driver.errors import ProtocolError
from hm_driver.protocol.commands import GetQuantity, SetParameter, parse_command
from hm_driver.protocol.vocabulary import Kind

MOST_PHRASES: Final = 48
MOST_COMMANDS: Final = 48
"""Commands in one request; a longer one is declined."""
ROW: Final = 128
"""Bytes of a row of the texts: the phrase in the first half, its reply in the second."""
HALF: Final = 64
LONGEST_LINE: Final = 4096
LONGEST_REPLY: Final = MOST_COMMANDS * max(HALF + 1, 3 * (LONGEST_NUMBER + 1) + 2) + 1

HOT_PARAMETERS = {"pos": E_POSITION, "vel": E_VELOCITY, "force": E_BIAS, "maxforce": E_MAX_FORCE}
"""Parameters that programs set in every cycle, with their place in an object's row."""

START: Final = cast("int", np.int64(0))
"""Where a text begins. What takes a plain 0 would be compiled once more, for zeros."""

KIND_WORD: Final = 0
KIND_VECTOR: Final = 1
KIND_SET_NUMBER: Final = 2
KIND_SET_VECTOR: Final = 3

# One row of integers a phrase, behind the count of phrases.
F_KIND: Final = 0
F_LENGTH: Final = 1
F_REPLY: Final = 2
F_PLACE: Final = 3
F_SIZE: Final = 4

_CLOSE, _COMMA, _BRACKET, _OPENING, _BLANK, _END = b";,][ \n"


class Book(NamedTuple):
    """Phrases as a kernel reads them."""

    texts: npt.NDArray[np.uint8]
    """`ROW` bytes a phrase."""
    fields: npt.NDArray[np.int64]
    """The count of phrases, then `F_SIZE` integers a phrase."""
    limits: npt.NDArray[np.float64]
    """Lowest and highest number of each phrase that sets something."""


@kernel
def starts_with(line: Text, at: int, size: int, texts: Text, start: int, length: int) -> bool:
    """Whether the line goes on with a text, and does not end there."""
    if at + length >= size:
        return False
    for i in range(length):  # noqa: SIM110  # a kernel knows no generators
        if line[at + i] != texts[start + i]:
            return False
    return True


@kernel
def find_phrase(line: Text, at: int, size: int, texts: Text, fields: Indices, guess: int) -> int:
    """Which phrase the line goes on with, or -1; a question must end there, as others begin alike."""
    count = fields[0]
    for attempt in range(count):
        phrase = guess + attempt
        if phrase >= count:
            phrase -= count
        first = 1 + phrase * F_SIZE
        length = fields[first + F_LENGTH]
        if starts_with(line, at, size, texts, phrase * ROW, length):
            byte = line[at + length]
            if fields[first + F_KIND] >= KIND_SET_NUMBER or byte in (_CLOSE, _END):
                return phrase
    return -1


@kernel
def take_number(line: Text, at: int, effects: Numbers, place: int, low: float, high: float) -> int:
    """Set one number; returns where the line goes on, or -1."""
    value, at = read_number(line, at)
    if at < 0 or line[at] not in (_CLOSE, _END) or not low <= value <= high:
        return -1
    effects[place] = value
    return at


@kernel
def take_vector(line: Text, at: int, effects: Numbers, place: int, low: float, high: float) -> int:
    """Set a vector, all of it or nothing; returns where the line goes on, or -1."""
    x, at = read_number(line, at)
    if at < 0 or line[at] != _COMMA:
        return -1
    y, at = read_number(line, at + 1)
    if at < 0 or line[at] != _COMMA:
        return -1
    z, at = read_number(line, at + 1)
    if at < 0 or line[at] != _BRACKET:
        return -1
    if not (low <= x <= high and low <= y <= high and low <= z <= high):
        return -1
    effects[place] = x
    effects[place + 1] = y
    effects[place + 2] = z
    return at + 1


@kernel
def tell_vector(reply: Text, at: int, outputs: Numbers, place: int) -> int:
    """Write a vector of the outputs; returns where the reply goes on."""
    reply[at] = _OPENING
    for i in range(3):
        at = write_number(reply, at + 1, outputs[place + i])
        reply[at] = _BRACKET if i == 2 else _COMMA
    return at + 1


@part
def answer(
    line: Text,
    size: int,
    texts: Text,
    fields: Indices,
    limits: Numbers,
    effects: Numbers,
    outputs: Numbers,
    reply: Text,
) -> int:
    """Carry out the commands of a line and write the line that answers it.

    What was set before something unusual stays set; the interpreter, which then gets the whole line, sets it
    again.

    Args:
        line: Request, its line end included.
        size: Its length.
        texts: Of the `Book`.
        fields: Of the `Book`.
        limits: Of the `Book`.
        effects: Rows of the objects.
        outputs: What can be asked.
        reply: Takes the answer, `LONGEST_REPLY` bytes.

    Returns:
        Length of the answer; 0 where the interpreter must be asked.
    """
    if size < 2 or line[size - 1] != _END:
        return 0
    at = told = guess = START
    for _ in range(MOST_COMMANDS):
        phrase = find_phrase(line, at, size, texts, fields, guess)
        if phrase < 0:
            return 0
        guess = phrase + 1
        first = 1 + phrase * F_SIZE
        kind = fields[first + F_KIND]
        place = fields[first + F_PLACE]
        at += fields[first + F_LENGTH]
        low, high = limits[2 * phrase], limits[2 * phrase + 1]
        if kind == KIND_SET_VECTOR:
            at = take_vector(line, at, effects, place, low, high)
        elif kind == KIND_SET_NUMBER:
            at = take_number(line, at, effects, place, low, high)
        if at < 0:
            return 0
        if kind == KIND_VECTOR:
            told = tell_vector(reply, told, outputs, place)
        else:
            for i in range(fields[first + F_REPLY]):
                reply[told + i] = texts[phrase * ROW + HALF + i]
            told += fields[first + F_REPLY]
        reply[told] = _CLOSE
        told += 1
        if line[at] == _CLOSE:
            at += 1
            while line[at] == _BLANK:
                at += 1
        elif line[at] != _END:
            return 0
        if line[at] == _END:
            if at != size - 1:
                return 0
            reply[told] = _END
            return told + 1
    return 0


class PhraseBook:
    """The phrases that were learned from requests to a device.

    Args:
        device: What the commands act on.
        vectors: Index in the outputs of each vector that can be asked for.
    """

    def __init__(self, device: EmulatedDevice, vectors: Mapping[str, int]) -> None:
        self._device = device
        self._vectors = vectors
        self._numbers: dict[str, int] = {}
        self._book = Book(
            np.zeros(MOST_PHRASES * ROW, dtype=np.uint8),
            np.zeros(1 + MOST_PHRASES * F_SIZE, dtype=np.int64),
            np.zeros(2 * MOST_PHRASES),
        )
        self._told_state = ""

    def book(self) -> Book:
        """The phrases, with what the device answers now; good until the interpreter is asked something."""
        state = self._device.state.value
        if state != self._told_state and "get state" in self._numbers:
            self._told_state = state
            self._lay_reply(self._numbers["get state"], state)
        return self._book

    def learn(self, text: str) -> None:
        """Enter the phrase of a command that was carried out; most commands have none."""
        try:
            command = parse_command(text)
        except ProtocolError:
            return
        match command:
            case GetQuantity("state"):
                self._enter(command.encode(), KIND_WORD, reply=self._device.state.value)
                self._told_state = ""
            case GetQuantity(name) if name in self._vectors:
                self._enter(command.encode(), KIND_VECTOR, place=self._vectors[name])
            case SetParameter(_, name, _) if name in HOT_PARAMETERS:
                self._learn_parameter(command)

    def forget(self) -> None:
        """Forget all phrases: objects come and go."""
        self._numbers.clear()
        self._book.fields[0] = 0

    def _learn_parameter(self, command: SetParameter) -> None:
        entry = self._device.find(command.object)
        description = entry.type.parameter(command.name)
        is_vector = description.kind is Kind.VECTOR
        self._enter(
            f"set {command.object} {command.name} {'[' if is_vector else ''}",
            KIND_SET_VECTOR if is_vector else KIND_SET_NUMBER,
            reply=description.reply,
            place=entry.slot * E_SIZE + HOT_PARAMETERS[command.name],
            limits=(description.low, description.high),
        )

    def _enter(
        self,
        phrase: str,
        kind: int,
        *,
        reply: str = "",
        place: int = 0,
        limits: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        number = len(self._numbers)
        if phrase in self._numbers or number == MOST_PHRASES or max(len(phrase), len(reply)) > HALF:
            return
        book = self._book
        self._numbers[phrase] = number
        book.texts[number * ROW : number * ROW + len(phrase)] = list(phrase.encode())
        book.fields[1 + number * F_SIZE : 1 + (number + 1) * F_SIZE] = kind, len(phrase), 0, place
        book.limits[2 * number : 2 * number + 2] = limits
        self._lay_reply(number, reply)
        book.fields[0] = number + 1

    def _lay_reply(self, number: int, reply: str) -> None:
        start = number * ROW + HALF
        self._book.texts[start : start + len(reply)] = list(reply.encode())
        self._book.fields[1 + number * F_SIZE + F_REPLY] = len(reply)
