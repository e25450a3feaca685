"""Each rule of ``hm log check`` is broken once, in a log that keeps all the others."""

import math

import pytest
from log_bench import at, write
from mcap.reader import make_reader

from tools.log.check import check


def broken(path):
    return {finding.rule: finding.found for finding in check(path) if not finding.is_kept}


def test_a_sound_log_keeps_every_rule(tmp_path):
    findings = check(write(tmp_path / "log.mcap"))
    assert [finding.rule for finding in findings if not finding.is_kept] == []
    assert len(findings) == 16


@pytest.mark.parametrize(
    ("topic", "place", "value", "rule", "found"),
    [
        ("/device/state", 5, 2.0, "model velocity is at most 1.5 m/s", "2 m/s at 0.120 s"),
        ("/device/state", 8, -90.0, "measured force is at most 80 N", "90.07 N at 0.120 s"),
        (
            "/device/state",
            4,
            0.3,
            "the arm stays within its end stops",
            "1 states beyond, the first: z = 0.3 m",
        ),
        ("/device/state", 2, math.nan, "every number is finite", "1 on /device/state"),
        ("/device/state", 1, 5, "time never runs backward on a topic", "1 on /device/state"),
        ("/device/command", 8, 31.0, "spring force is at most 30 N", "31 N at 0.120 s"),
        ("/device/command", 5, 0.4, "reference velocity is at most 0.3 m/s", "0.4 m/s at 0.120 s"),
        ("/device/command", 15, 11.0, "assist force is at most 10 N", "11 N at 0.120 s"),
        ("/device/command", 18, 11.0, "bias force is at most 10 N", "11 N at 0.120 s"),
        ("/teaching/arbitration", 2, 1.5, "C and w_max are between 0 and 1", "1 on C"),
        ("/teaching/arbitration", 3, math.nan, "C and w_max are between 0 and 1", "1 on w_max"),
        ("/teaching/arbitration", 1, 0, "the stages follow each other", "1 steps back"),
    ],
)
def test_a_broken_rule_is_named_with_what_was_found(tmp_path, topic, place, value, rule, found):
    result = broken(write(tmp_path / "log.mcap", change=at(topic, 120, place, value)))
    assert list(result) == [rule]
    assert result[rule].startswith(found)


def test_lost_messages_are_counted_also_where_the_loop_did_not_miss_them(tmp_path):
    result = broken(write(tmp_path / "log.mcap", lost={50, 51}))
    assert result["no message was lost"].startswith("1 on /device/command")


def test_periods_that_nobody_counted_are_found(tmp_path):
    path = write(tmp_path / "log.mcap", change=shift)
    assert broken(path) == {"cycles run and periods missed are the grid": "299 run + 0 missed of 304"}


def shift(topic, cycle, values):
    if topic == "/loop/timing" and cycle >= 200:
        values[0] += 5


def test_an_event_of_an_error_is_told(tmp_path):
    result = broken(write(tmp_path / "log.mcap", level=4))
    assert result == {"no event tells of an error": "0.300 s trip: force 90 N"}


def test_a_flipped_bit_breaks_the_first_rule(tmp_path):
    path = write(tmp_path / "log.mcap")
    with path.open("rb") as file:
        chunk = make_reader(file).get_summary().chunk_indexes[3]
    data = bytearray(path.read_bytes())
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 1
    path.write_bytes(data)
    assert "every file is whole and bears out its checksums" in broken(path)
