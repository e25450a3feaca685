"""The client's side of a cycle, for kernels: what `EffectCommands`, `Exchange` and `Publisher` do, on arrays.

The loop's own classes stay the only description of *what* is said and logged: the texts come from them, and
`tests/tools/test_run_compiled.py` compares requests and logs byte for byte.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from emulator.compilation import kernel, part
from emulator.number_text import Text, read_number, write_number
from emulator.phrases import LONGEST_LINE, LONGEST_REPLY, START
from hm_driver.realtime.commands import BIAS_COMMAND, SPRING_COMMANDS
from hm_driver.realtime.cycle import (
    ADMITTANCE,
    ASSIST,
    AXES,
    MEASUREMENT_SIZE,
    OK,
    P_BY_FORCE,
    PHASE,
    REFERENCE,
    S_BIAS,
    S_FORCE,
    S_PUSH,
    S_SATURATED,
    SETPOINT_SIZE,
    SPRING_STRIDE,
    SPRINGS,
    STATE_SIZE,
    VELOCITY,
)
from hm_driver.realtime.measurements import TAILS
from hm_driver.recording.schemas import LOOP_BUNDLE, FixedMessage
from tools.run.compiled_cycle import compile_cycle

cycle = compile_cycle()

# Counts: integers that the kernels keep.
N_CYCLES: Final = 0
"""Cycles run."""
N_STAGE: Final = 1
"""Where in a cycle the loop stands."""
N_STEP: Final = 2
"""Steps that the emulator has run."""
N_CHANGES: Final = 3
"""Commands of the next request, before its questions."""
N_SAID: Final = 4
"""Bytes of them."""
N_REQUEST: Final = 5
"""Bytes of the whole request."""
N_REPLY: Final = 6
"""Bytes of the reply."""
N_SIZE: Final = 7

ROW: Final = 64
"""Bytes of a row of the words."""
W_SPRING: Final = 8
"""Rows for each spring: before and behind each of its three numbers, then enable and disable."""
W_ENABLE: Final = 6
W_BIAS: Final = SPRINGS * W_SPRING
W_TAIL: Final = W_BIAS + 2
W_STATE: Final = W_TAIL + 2
NUMBER: Final = 16
"""Bytes kept of a number's text."""
MOST_CYCLES: Final = 32
"""Records that are packed before Python takes them."""
RECORD: Final = LOOP_BUNDLE.size

_CLOSE, _COMMA, _BRACKET, _OPENING, _MINUS, _END = b";,][-\n"


class Client(NamedTuple):
    """The loop's memory."""

    s: npt.NDArray[np.float64]
    """State of the cycle function."""
    p: npt.NDArray[np.float64]
    """Its parameters."""
    u: npt.NDArray[np.float64]
    """The set-point."""
    m: npt.NDArray[np.float64]
    """The measurement."""
    before: npt.NDArray[np.float64]
    """State and measurement before the present cycle."""
    told: npt.NDArray[np.float64]
    """What the springs and, behind them, the bias force were told last."""
    texts: npt.NDArray[np.uint8]
    """The springs' part of it as it went over the wire, `NUMBER` bytes each."""
    lengths: npt.NDArray[np.int64]
    """Lengths of these texts."""
    enabled: npt.NDArray[np.int64]
    """1 for each spring that is enabled."""
    words: npt.NDArray[np.uint8]
    """What stands around the numbers, `ROW` bytes each."""
    word_lengths: npt.NDArray[np.int64]
    counts: npt.NDArray[np.int64]
    changes: npt.NDArray[np.uint8]
    """The commands of the next request."""
    request: npt.NDArray[np.uint8]
    """The present request."""
    reply: npt.NDArray[np.uint8]


class Records(NamedTuple):
    """Where the log's records are packed."""

    values: npt.NDArray[np.float64]
    """The values of one record."""
    integers: npt.NDArray[np.int64]
    """The same memory."""
    data: npt.NDArray[np.uint8]
    """The same memory."""
    places: npt.NDArray[np.int64]
    """Where each value stands in a record."""
    rows: npt.NDArray[np.uint8]
    """`MOST_CYCLES` records, with all but the values filled in."""


def make_client(parameters: Sequence[float], session_state: str) -> Client:
    """The memory of a loop before its first cycle."""
    texts = [part for commands in SPRING_COMMANDS for part in _around_numbers(commands)]
    texts += [BIAS_COMMAND.split("%g")[0], BIAS_COMMAND.split("%g")[-1] + "; ", *TAILS, session_state]
    words = np.zeros((len(texts), ROW), dtype=np.uint8)
    for row, text in zip(words, texts, strict=True):
        row[: len(text)] = list(text.encode())
    springs = SPRINGS * SPRING_STRIDE
    return Client(
        s=np.zeros(STATE_SIZE),
        p=np.array(parameters),
        u=np.zeros(SETPOINT_SIZE),
        m=np.zeros(MEASUREMENT_SIZE),
        before=np.zeros(STATE_SIZE + MEASUREMENT_SIZE),
        told=np.array([np.nan] * springs + [0.0] * AXES),
        texts=np.zeros(springs * NUMBER, dtype=np.uint8),
        lengths=np.zeros(springs, dtype=np.int64),
        enabled=np.zeros(SPRINGS, dtype=np.int64),
        words=words.reshape(-1),
        word_lengths=np.array([len(text) for text in texts]),
        counts=np.zeros(N_SIZE, dtype=np.int64),
        changes=np.zeros(LONGEST_LINE, dtype=np.uint8),
        request=np.zeros(LONGEST_LINE, dtype=np.uint8),
        reply=np.zeros(LONGEST_REPLY, dtype=np.uint8),
    )


def make_records() -> Records:
    """Records whose values are all zero."""
    places, at = [], 0
    for channel in LOOP_BUNDLE.channels:
        if isinstance(channel.message, FixedMessage):
            for tag, _ in channel.message.layout:
                places.append(at + len(tag))
                at += len(tag) + 8
    values = np.zeros(len(places))
    empty = np.frombuffer(LOOP_BUNDLE.pack(*[0] * len(places)), dtype=np.uint8)
    return Records(
        values, values.view(np.int64), values.view(np.uint8), np.array(places), np.tile(empty, MOST_CYCLES)
    )


def _around_numbers(commands: Sequence[str]) -> list[str]:
    parts = [part for command in commands[:3] for part in command.split("%s")]
    return [text + "; " * (index % 2) for index, text in enumerate(parts)] + [
        command + "; " for command in commands[3:]
    ]


@kernel
def say(client: Client, line: Text, row: int, at: int) -> int:
    """Add a row of the words to a line; returns where it goes on."""
    for i in range(client.word_lengths[row]):
        line[at + i] = client.words[row * ROW + i]
    return at + int(client.word_lengths[row])


@kernel
def say_number(client: Client, spring: int, index: int, at: int) -> int:
    """Say a number of a spring if its text on the wire has changed; returns where the changes go on."""
    cell = spring * SPRING_STRIDE + index
    value = client.s[cell]
    if value == client.told[cell]:
        return at
    client.told[cell] = value
    row = spring * W_SPRING + 2 * index
    start = say(client, client.changes, row, at)
    end = write_number(client.changes, start, value)
    is_new = client.lengths[cell] != end - start
    client.lengths[cell] = end - start
    for i in range(end - start):
        if client.texts[cell * NUMBER + i] != client.changes[start + i]:
            client.texts[cell * NUMBER + i] = client.changes[start + i]
            is_new = True
    if not is_new:
        return at
    client.counts[N_CHANGES] += 1
    return say(client, client.changes, row + 1, end)


@part
def say_changes(client: Client) -> None:
    """Begin the next request by what changed, as `EffectCommands.changes` does."""
    client.counts[N_CHANGES] = 0
    at = START
    first = ASSIST if client.p[P_BY_FORCE] > 0.0 else 0
    for spring in range(first, SPRINGS):
        is_on = client.s[spring * SPRING_STRIDE + PHASE] != ADMITTANCE
        if is_on:
            for index in range(PHASE):
                at = say_number(client, spring, index, at)
        if is_on != (client.enabled[spring] != 0):
            client.enabled[spring] = 1 if is_on else 0
            client.counts[N_CHANGES] += 1
            at = say(client, client.changes, spring * W_SPRING + W_ENABLE + (0 if is_on else 1), at)
    is_new = False
    for axis in range(AXES):
        cell = SPRINGS * SPRING_STRIDE + axis
        if client.told[cell] != client.s[S_PUSH + axis]:
            client.told[cell] = client.s[S_PUSH + axis]
            is_new = True
    if is_new:
        client.counts[N_CHANGES] += 1
        at = say(client, client.changes, W_BIAS, at)
        for axis in range(AXES):
            at = write_number(client.changes, at, client.s[S_PUSH + axis])
            if axis + 1 < AXES:
                client.changes[at] = _COMMA
                at += 1
        at = say(client, client.changes, W_BIAS + 1, at)
    client.counts[N_SAID] = at


@part
def ask(client: Client, is_state_asked: bool) -> None:  # noqa: FBT001  # flat scalars, for the compiler
    """End the request by the questions."""
    tail = W_TAIL + (1 if is_state_asked else 0)
    said = client.counts[N_SAID]
    for i in range(said):
        client.request[i] = client.changes[i]
    client.counts[N_REQUEST] = say(client, client.request, tail, said)


@part
def skip_acknowledgements(client: Client) -> int:
    """Where the answers to the questions begin; -1 where a change may have been refused."""
    at = 0
    for _ in range(client.counts[N_CHANGES]):
        byte = client.reply[at]
        while byte != _CLOSE:
            if byte in (_OPENING, _MINUS, _END):  # no acknowledgement has these, every refusal has one
                return -1
            at += 1
            byte = client.reply[at]
        at += 1
    return at


@part
def hear(client: Client, is_state_asked: bool) -> bool:  # noqa: FBT001  # as above
    """Read the measurement; False where anything in the reply is unusual."""
    reply, size = client.reply, client.counts[N_REPLY]
    if size < 1 or reply[size - 1] != _END:
        return False
    at = skip_acknowledgements(client)
    if at < 0:
        return False
    for i in range(MEASUREMENT_SIZE):
        is_first, is_last = i % AXES == 0, i % AXES == AXES - 1
        if is_first:
            if reply[at] != _OPENING:
                return False
            at += 1
        value, at = read_number(reply, at)
        if at < 0 or reply[at] != (_BRACKET if is_last else _COMMA):
            return False
        client.m[i] = value
        at += 1
        if is_last:
            if reply[at] != _CLOSE:
                return False
            at += 1
    if is_state_asked:
        length = client.word_lengths[W_STATE]
        for i in range(length):
            if reply[at + i] != client.words[W_STATE * ROW + i]:
                return False
        if reply[at + length] != _CLOSE:
            return False
        at += length + 1
    return bool(at == size - 1)


@part
def take_reply(client: Client, is_state_asked: bool, dt: float) -> bool:  # noqa: FBT001  # as above
    """Run the cycle function on a reply, and begin the next request.

    Returns:
        False where the reply is unusual or a limit trips; all is then as before the cycle.
    """
    for i in range(STATE_SIZE):
        client.before[i] = client.s[i]
    for i in range(MEASUREMENT_SIZE):
        client.before[STATE_SIZE + i] = client.m[i]
    if hear(client, is_state_asked) and cycle(client.s, client.p, client.u, client.m, dt) == OK:
        say_changes(client)
        return True
    for i in range(STATE_SIZE):
        client.s[i] = client.before[i]
    for i in range(MEASUREMENT_SIZE):
        client.m[i] = client.before[STATE_SIZE + i]
    return False


@part
def pack_record(client: Client, records: Records, row: int, index: int, time_ns: int, dt: float) -> None:
    """Pack the record of a cycle, in the order of `Publisher.publish`; nothing takes time."""
    values, integers, s = records.values, records.integers, client.s
    integers[0] = index
    integers[1] = time_ns
    for i in range(MEASUREMENT_SIZE):
        values[2 + i] = client.m[i]
    at = 2 + MEASUREMENT_SIZE
    integers[at] = index
    integers[at + 1] = time_ns
    at += 2
    for axis in range(AXES):
        base = axis * SPRING_STRIDE
        values[at + axis] = s[base + REFERENCE]
        values[at + AXES + axis] = s[base + VELOCITY]
        values[at + 2 * AXES + axis] = s[S_FORCE + axis]
        values[at + 3 * AXES + axis] = s[base + PHASE]
        values[at + 4 * AXES + 2 + axis] = s[S_BIAS + axis]
    at += 4 * AXES
    values[at] = s[ASSIST * SPRING_STRIDE + REFERENCE]
    values[at + 1] = s[S_FORCE + ASSIST]
    at += 2 + AXES
    integers[at] = index
    integers[at + 1] = time_ns
    values[at + 7] = dt
    integers[at + 8] = int(s[S_SATURATED])
    start = row * RECORD
    for k in range(len(records.places)):
        place = start + records.places[k]
        for i in range(8):
            records.rows[place + i] = records.data[8 * k + i]
