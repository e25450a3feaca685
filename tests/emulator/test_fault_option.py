"""Faults in one word on the command line."""

import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.fault_option import parse_fault_option
from emulator.faults import KINDS, Fault
from hm_driver.errors import ConfigurationError

HM = [sys.executable, "-m", "tools.cli.main", "emulate", "--listen", "tcp://127.0.0.1:0"]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("frozen", Fault(kind="frozen")),
        ("frozen+0.3", Fault(kind="frozen", duration_s=0.3)),
        ("connection_reset@20", Fault(kind="connection_reset", at_s=20)),
        ("reply_delay=0.02", Fault(kind="reply_delay", value=0.02)),
        ("reply_delay=2e-2@5+1", Fault(kind="reply_delay", value=0.02, at_s=5, duration_s=1)),
        ("init_takes=+1e+2+3", Fault(kind="init_takes", value=100.0, duration_s=3)),
        ("frozen@1e+1+1e+0", Fault(kind="frozen", at_s=10.0, duration_s=1.0)),
        ("force_bias=3,-1.5,0@2", Fault(kind="force_bias", value=(3, -1.5, 0), at_s=2)),
        ("force_bias=[+3, +4, 0]+2", Fault(kind="force_bias", value=(3, 4, 0), duration_s=2)),
    ],
)
def test_a_fault_in_one_word_is_the_fault_of_the_schedule(text, fault):
    assert parse_fault_option(text) == fault


@given(kind=st.sampled_from(sorted(KINDS)), share=st.floats(0.0, 1.0), data=st.data())
def test_every_kind_value_and_time_can_be_said_in_one_word(kind, share, data):
    takes = KINDS[kind]
    number = takes.low + share * (takes.high - takes.low)
    value = {0: None, 1: number, 3: (number, takes.low, takes.high)}[takes.size]
    start, duration = (data.draw(st.none() | st.floats(0.0, 1e6)) for _ in range(2))
    text = kind
    if value is not None:
        text += "=" + (repr(value) if takes.size == 1 else ",".join(map(repr, value)))
    text += "" if start is None else f"@{start!r}"
    text += "" if duration is None else f"+{duration!r}"
    assert parse_fault_option(text) == Fault(
        kind=kind, value=value, at_s=0.0 if start is None else start, duration_s=duration
    )


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("reply_dely=0.02", "did you mean reply_delay? accepted: reply_delay, reply_jitter"),
        ("gremlins", "'gremlins' is unknown; accepted: reply_delay, reply_jitter"),
        ("", "KIND[=VALUE][@START][+DURATION]"),
        ("@5", "KIND[=VALUE][@START][+DURATION]"),
        ("reply_delay", "reply_delay takes a number of 0 to 60 s, not None"),
        ("reply_delay=", "not ''"),
        ("reply_delay=20ms", "a number of 0 to 60 s, not '20ms'"),
        ("reply_delay=61", "a number of 0 to 60 s, not 61"),
        ("reply_lost=nan", "a number of 0 to 1, not nan"),
        ("frozen=3", "frozen takes no value, not 3"),
        ("force_bias=1,2", "three numbers of -500 to 500 N"),
        ("frozen@soon", "fault.at_s: 'soon' must be 0 to 1e+06 s"),
        ("frozen@-1", "fault.at_s: -1 must be"),
        ("frozen@nan", "fault.at_s: nan must be"),
        ("frozen+", "fault.duration_s: '' must be"),
        ("frozen+inf", "fault.duration_s: inf must be"),
    ],
)
def test_what_is_wrong_is_told_with_the_option_and_what_would_be_accepted(text, named):
    with pytest.raises(ConfigurationError) as refusal:
        parse_fault_option(text)
    assert str(refusal.value).startswith(f"--fault {text}: fault")
    assert named in str(refusal.value)


@given(st.text(max_size=30))
def test_any_text_is_a_fault_or_refused(text):
    try:
        parse_fault_option(text)
    except ConfigurationError:
        return


def test_faults_of_the_command_line_befall_the_device_at_their_times(start_emulator, connect):
    emulator = start_emulator(fault=("reply_error=1@0.2", "emergency_button@0+0.1"), lockstep=True)
    client = connect(emulator)
    with emulator.connect_world() as world:
        world.advance(0.01)
        assert client.ask("get emergencybuttonpushed") == "true;"
        world.advance(0.15)
        assert client.ask("get emergencybuttonpushed") == "false;"
        world.advance(0.1)
        assert "injected fault" in client.ask("get os")


@pytest.mark.parametrize(
    ("text", "named"),
    [("reply_dely=1", "did you mean reply_delay?"), ("reply_delay=1000", "a number of 0 to 60 s, not 1000")],
)
def test_the_command_refuses_a_wrong_fault_before_it_starts(text, named):
    command = [*HM, "--fault", "frozen@5", "--fault", text]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert f"--fault {text}" in done.stderr
    assert named in done.stderr
    assert "Traceback" not in done.stderr
