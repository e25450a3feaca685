import io
import os
import pty
import select
import signal
import statistics
import subprocess
import sys
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tools.live import LiveView, SessionStatus
from tools.live.lines import LineScreen, line
from tools.live.panel import bar, picture
from tools.live.status import TEXT_LENGTH, decode, encode

STATUS = SessionStatus(
    time_s=12.5,
    stage="teaching",
    C=1.0,
    force_n=9.8,
    reference_force_n=10.0,
    models=31,
    coverage=0.42,
    updates=1,
    accumulated=250,
    accumulation_length=1000,
    loop_rate_hz=1000.0,
    missed_periods=0,
    lateness_p99_us=41.0,
    scheduling="SCHED_FIFO 80",
)

finite = st.floats(allow_nan=False)
counts = st.integers(0, 2**62)
words = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=TEXT_LENGTH)
statuses = st.builds(
    SessionStatus,
    time_s=finite,
    stage=words,
    C=st.floats(0.0, 1.0),
    force_n=finite,
    reference_force_n=finite,
    models=counts,
    coverage=st.floats(0.0, 1.0),
    updates=counts,
    accumulated=counts,
    accumulation_length=counts,
    loop_rate_hz=st.none() | finite,
    missed_periods=counts,
    lateness_p99_us=st.none() | finite,
    scheduling=words,
    coverage_goal=finite,
    force_tolerance_n=finite,
    messages=st.lists(words, max_size=3).map(tuple),
)


def read_until(fd, wanted, timeout_s=20.0):
    data = b""
    deadline = time.monotonic() + timeout_s
    while wanted not in data:
        remaining = deadline - time.monotonic()
        assert remaining > 0, f"{wanted!r} did not come; this did: {data!r}"
        if select.select([fd], [], [], remaining)[0]:
            data += os.read(fd, 65536)
    return data


@pytest.fixture
def terminal(monkeypatch):
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    controller, terminal = pty.openpty()
    yield controller, terminal
    os.close(controller)
    os.close(terminal)


@pytest.fixture
def pipe():
    reading, writing = os.pipe()
    yield reading, writing
    os.close(reading)
    os.close(writing)


@given(status=statuses)
def test_a_status_survives_the_way_through_the_pipe(status):
    assert decode(encode(status, status.messages, 100_000)) == ([status], b"")


@given(sent=st.lists(statuses, max_size=4), cut=st.integers(0, 3000))
def test_records_cut_anywhere_are_put_together_again(sent, cut):
    data = b"".join(encode(status, status.messages, 100_000) for status in sent)
    first, rest = decode(data[:cut])
    second, rest = decode(rest + data[cut:])
    assert (first + second, rest) == (sent, b"")


def test_of_too_many_messages_the_oldest_are_left_out():
    data = encode(STATUS, tuple(f"message {n} {'x' * 100}" for n in range(20)), 512)
    assert len(data) <= 512
    assert decode(data)[0][0].messages[-1].startswith("message 19")


def test_values_of_numpy_are_taken_as_numbers():
    numpy = pytest.importorskip("numpy")
    odd = STATUS._replace(force_n=numpy.float32(1.5), models=numpy.int64(7))
    assert decode(encode(odd, (), 512))[0][0].models == 7


@pytest.mark.parametrize(("factor", "who"), [(1.0, "human"), (0.5, "blending"), (0.0, "robot")])
def test_the_control_factor_says_who_is_in_control(factor, who):
    assert STATUS._replace(C=factor).control == who


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def lines(tmp_path):
    clock = Clock()
    with (tmp_path / "lines.txt").open("w+") as stream:
        screen = LineScreen(stream, clock)

        def show(elapsed_s=0.0, **changes):
            clock.now += elapsed_s
            screen.show([STATUS._replace(**changes)])
            stream.seek(0)
            return stream.read().splitlines()

        yield show


def test_plain_lines_come_once_a_second(lines):
    assert len(lines()) == 1
    assert len(lines(0.5)) == 1
    assert len(lines(0.5)) == 2


@pytest.mark.parametrize("change", [{"stage": "autonomous"}, {"updates": 2}, {"C": 0.0}])
def test_a_change_of_stage_updates_or_control_is_told_at_once(lines, change):
    lines()
    assert len(lines(0.3, **change)) == 2


def test_a_blend_alone_is_no_change_of_control(lines):
    lines()
    lines(0.3, C=0.5)
    assert len(lines(0.3, C=1.0)) == 1


def test_control_that_flickers_does_not_flood_the_log(lines):
    for step in range(40):
        written = lines(0.02, C=float(step % 2))
    assert len(written) <= 5


def test_each_message_is_told_once(lines):
    assert sum("learned" in text for text in lines(messages=("update 1 learned",))) == 1
    assert sum("learned" in text for text in lines(2.0)) == 1


def test_the_line_says_what_a_person_wants_to_know():
    text = line(STATUS)
    for part in (
        "teaching",
        "human",
        "9.8/10.0 N",
        "models 31",
        "coverage 42 %",
        "1000 Hz, 0 missed, p99 41",
    ):
        assert part in text


@pytest.mark.parametrize("share", [-1.0, 0.0, 0.5, 1.0, 7.0, float("nan"), float("inf")])
def test_a_bar_keeps_its_width_whatever_it_is_given(share):
    assert len(bar(share, style="green", zone=(0.45, 0.55))) == len(bar(0.5, style="green"))


def test_the_picture_can_be_drawn_without_a_task_and_in_ascii():
    from rich.console import Console

    stream = io.StringIO()
    odd = STATUS._replace(reference_force_n=0.0, accumulation_length=0)
    Console(width=100, file=stream).print(picture(odd, ascii_only=True))
    assert "* the human leads" in stream.getvalue()


def test_without_a_terminal_plain_lines_are_written(pipe):
    reading, writing = pipe
    with LiveView(stream=writing) as view:
        view.update(STATUS._replace(messages=("hand over",)))
    text = read_until(reading, b"41").decode()
    assert "hand over" in text
    assert "\x1b" not in text


def test_on_a_terminal_a_panel_is_drawn_and_the_cursor_given_back(terminal):
    controller, stream = terminal
    with LiveView(stream=stream) as view:
        view.update(STATUS)
        assert b"\x1b[?25l" in read_until(controller, b"the human leads")
    assert b"\x1b[?25h" in read_until(controller, b"\x1b[?25h")


def test_ctrl_c_does_not_end_the_picture_before_its_session(terminal):
    controller, stream = terminal
    with LiveView(stream=stream) as view:
        os.kill(view._process.pid, signal.SIGINT)
        view.update(STATUS)
        read_until(controller, b"the human leads")
        os.kill(view._process.pid, signal.SIGINT)
        view.update(STATUS._replace(C=0.0))
        read_until(controller, b"the robot leads")
        process = view._process
    assert process.returncode == 0


def test_a_drawing_process_that_dies_disturbs_nobody_and_the_cursor_comes_back(terminal):
    controller, stream = terminal
    with LiveView(stream=stream) as view:
        view.update(STATUS)
        read_until(controller, b"the human leads")
        view._process.kill()
        view._process.wait()
        for _ in range(3):
            view.update(STATUS)
    assert b"\x1b[?25h" in read_until(controller, b"\x1b[?25h")


def test_a_terminal_that_stands_still_never_stops_the_session(pipe):
    reading, writing = pipe
    with LiveView(stream=writing) as view:
        view.update(STATUS)
        read_until(reading, b"41")
        view._process.send_signal(signal.SIGSTOP)
        costs = []
        for number in range(3000):
            start = time.perf_counter()
            view.update(STATUS._replace(messages=(f"message {number}",)))
            costs.append(time.perf_counter() - start)
        assert view.dropped > 0
        assert statistics.median(costs) < 0.001
        view._process.send_signal(signal.SIGCONT)
        deadline = time.monotonic() + 10.0
        while view._messages and time.monotonic() < deadline:
            time.sleep(0.05)
            view.update(STATUS)
        assert b"message 2999" in read_until(reading, b"message 2999")


def test_the_terminal_is_sane_after_its_session_was_killed(terminal):
    controller, stream = terminal
    script = (
        "import sys, time\n"
        "from tools.live import LiveView, SessionStatus\n"
        f"with LiveView(stream={stream}) as view:\n"
        f"    view.update(SessionStatus(**{STATUS._asdict()!r}))\n"
        "    time.sleep(60)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", script], pass_fds=[stream])
    try:
        read_until(controller, b"the human leads")
    finally:
        parent.kill()
        parent.wait()
    assert b"\x1b[?25h" in read_until(controller, b"\x1b[?25h")


def test_a_disabled_view_and_a_closed_one_do_nothing(pipe):
    with LiveView(enabled=False) as view:
        view.update(STATUS)
    with LiveView(stream=pipe[1]) as view:
        view.close()
        view.update(STATUS)
        view.close()


@pytest.mark.timing
def test_an_update_costs_little_more_than_writing_to_a_pipe(pipe):
    reading, writing = pipe
    os.set_blocking(writing, False)
    floor, costs = [], []
    record = encode(STATUS, (), 512)
    with LiveView(stream=writing, plain=True) as view:
        for _ in range(300):
            start = time.perf_counter()
            os.write(writing, record)
            floor.append(time.perf_counter() - start)
            os.read(reading, 65536)
            start = time.perf_counter()
            view.update(STATUS)
            costs.append(time.perf_counter() - start)
    assert statistics.median(costs) < 50e-6 + 5.0 * statistics.median(floor)
