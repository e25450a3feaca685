"""Requests that a kernel answers: byte for byte and bit for bit what the interpreter would do."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from emulator.compilation import entry_point
from emulator.device import EmulatedDevice
from emulator.interpreter import Interpreter
from emulator.number_text import read_number, write_number
from emulator.parameters import load_parameters
from emulator.phrases import LONGEST_LINE, LONGEST_REPLY, MOST_COMMANDS, answer
from hm_driver.protocol.framing import Dialect

LOOP = "set s maxforce 30; set s pos [0,0,0.1]; set s vel [0,0,0]; set b force [1,2,3]"
QUESTIONS = "get measpos; get modelvel; get measforce"
BRING_UP = f"""set state init
create spring s
set s direction [0,0,1]
create biasforce b
{LOOP}; {QUESTIONS}; get state
get measposjoint; get modelacc"""


@entry_point
def _answer(line, size, texts, fields, limits, effects, outputs, reply):
    return answer(line, size, texts, fields, limits, effects, outputs, reply)


@entry_point
def _write(text, x):
    return write_number(text, 0, x)


@entry_point
def _read(text):
    return read_number(text, 0)


class Peer:
    """A device with its interpreter, and the compiled way around it."""

    def __init__(self):
        self.device = EmulatedDevice(load_parameters(), seed=1)
        self.interpreter = Interpreter(self.device)
        self.reply = np.zeros(LONGEST_REPLY, dtype=np.uint8)
        for line in BRING_UP.splitlines():
            assert b"ERROR" not in self.interpreter.reply(line, Dialect.TEXT)
        self.device.advance(700)

    def ask_interpreter(self, text):
        return self.interpreter.reply(text, Dialect.TEXT)

    def ask_kernel(self, text):
        """The reply, or None where the kernel declines."""
        line = np.zeros(LONGEST_LINE, dtype=np.uint8)
        data = text.encode() + b"\n"
        line[: len(data)] = list(data)
        device = self.device
        book = self.interpreter.phrases.book()
        flat = device.arm.effects.flat
        size = _answer(line, len(data), *book, flat, device.arm.outputs, self.reply)
        return self.reply[:size].tobytes() if size else None

    def rows(self):
        return self.device.effect_rows.tobytes()


@pytest.fixture(scope="module")
def peers():
    return Peer(), Peer()


ODD_NUMBERS = ["", " 1", "1 ", *["-", ".", "1.", ".5", "+2", "-0", "1e", "1e5", "1E-3", "1_0", "nan", "0x1"]]
OTHERS = ["get measpo", "", "set s enable", "set s disable", "get inertia", "set s  pos [0,0,0]", "get s pos"]

numbers = st.one_of(
    st.floats(-3.0, 3.0).map(lambda x: f"{x:g}"),
    st.floats(-1200.0, 1200.0).map(repr),
    st.floats().map(repr),
    st.integers(-3000, 3000).map(str),
    st.sampled_from(ODD_NUMBERS),
)
vectors = st.one_of(
    st.lists(numbers, min_size=3, max_size=3).map(lambda parts: f"[{','.join(parts)}]"),
    st.lists(numbers, max_size=4).map(lambda parts: f"[{', '.join(parts)}]"),
)
commands = st.one_of(
    st.sampled_from([*QUESTIONS.split("; "), "get state", "get measposjoint"]),
    st.tuples(st.sampled_from(["s pos", "s vel", "b force", "b pos"]), vectors).map(
        lambda parts: f"set {parts[0]} {parts[1]}"
    ),
    numbers.map(lambda value: f"set s maxforce {value}"),
    st.sampled_from(OTHERS),
)
requests = st.tuples(
    st.lists(commands, min_size=1, max_size=6),
    st.sampled_from(["; ", ";", " ; ", ";  "]),
    st.sampled_from(["", ";", " "]),
).map(lambda parts: parts[1].join(parts[0]) + parts[2])


@settings(max_examples=600, deadline=None)
@given(request=requests)
def test_a_request_is_answered_by_the_kernel_as_by_the_interpreter_or_not_at_all(peers, request):
    one, other = peers
    one.device.effect_rows[:] = other.device.effect_rows[:]
    told = one.ask_kernel(request)
    expected = other.ask_interpreter(request)
    if told is None:
        told = one.ask_interpreter(request)
    assert told == expected
    assert one.rows() == other.rows()


@pytest.mark.parametrize(
    "request_text",
    [
        "get measpos; get modelvel; get measforce",
        "get measpos; get modelvel; get measforce; get state",
        "set s pos [0,0,0.0123457]; get measpos",
        "set s maxforce 12.5; set s vel [0,0,-1e-05]; set b force [1.5,-2,0]; get state;",
        "get measposjoint",
    ],
)
def test_what_a_loop_says_in_each_cycle_is_not_declined(peers, request_text):
    one, other = peers
    assert one.ask_kernel(request_text) == other.ask_interpreter(request_text)


def test_a_request_of_many_commands_is_left_to_the_interpreter(peers):
    assert peers[0].ask_kernel(";".join(["get measpos"] * MOST_COMMANDS)) is not None
    assert peers[0].ask_kernel(";".join(["get measpos"] * (MOST_COMMANDS + 1))) is None


def test_the_state_is_told_as_it_is_now():
    peer = Peer()
    assert peer.ask_kernel("get state") == b"init;\n"
    peer.device.advance(20_000)
    assert peer.ask_kernel("get state") == b"stop;\n"


def test_phrases_of_an_object_are_forgotten_with_it():
    peer = Peer()
    assert peer.ask_kernel("set s maxforce 3") is not None
    peer.ask_interpreter("remove s")
    assert peer.ask_kernel("set s maxforce 3") is None
    assert b"ERROR" in peer.ask_interpreter("set s maxforce 3")


bits = st.integers(0, 2**64 - 1).map(lambda number: float(np.array(number, np.uint64).view(np.float64)))
doubles = st.one_of(bits, st.floats(-10.0, 10.0), st.integers(-(10**8), 10**8).map(lambda n: n * 5e-7))


@settings(max_examples=2000, deadline=None)
@given(x=doubles)
def test_a_number_is_written_as_the_format_of_six_digits_writes_it(x):
    text = np.zeros(32, dtype=np.uint8)
    assert text[: _write(text, x)].tobytes().decode() == "%g" % x  # noqa: UP031  # the wire's format


@settings(max_examples=2000, deadline=None)
@given(x=doubles, form=st.sampled_from(["%g", "%r", "%.3f", "%.9e", "%+.2E"]))
@example(x=1e-250, form="%g")
@example(x=9.99999e248, form="%g")
@example(x=1.00001e-249, form="%g")
def test_a_number_is_read_as_python_reads_it_or_declined(x, form):
    printed = form % x
    text = np.zeros(400, dtype=np.uint8)
    text[: len(printed)] = list(printed.encode())
    value, at = _read(text)
    if at >= 0:
        assert at == len(printed)
        assert math.copysign(1.0, value) == math.copysign(1.0, float(printed))
        assert value == float(printed)
    elif form == "%g":
        assert not math.isfinite(x) or not 1e-249 < abs(x) < 1e249
