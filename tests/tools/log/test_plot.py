import re

import numpy as np
import pytest
from log_bench import MS, at, write

from hm_driver.errors import RecordingError
from hm_driver.recording.reader import Recording
from tools.cli.main import run
from tools.log import plot
from tools.log.curves import BINS, Curve, Envelope, by_unit
from tools.log.signals import Signal, find_signals, short_names
from tools.log.terminal import render


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write(tmp_path_factory.mktemp("log") / "log.mcap")


def names_of(log, *names):
    with Recording(log) as recording:
        return [signal.name for signal in find_signals(recording, names)]


def curve_of(values, *, is_whole=False, unit="N"):
    values = np.asarray(values, dtype=float)
    signal = Signal(topic="/a", column="b", unit=unit, is_whole=is_whole)
    time_s = np.arange(len(values)) / max(1, len(values) - 1)
    return Curve(signal=signal, time_s=time_s, values=values, smallest=values.min(), largest=values.max())


def test_a_signal_has_its_full_name_or_its_column_s(log):
    full = "/device/state.measured_force.z"
    assert names_of(log, full, "measured_force.z") == [full]
    assert names_of(log, "C", "force") == ["/teaching/arbitration.C", "/teaching/arbitration.force"]


def test_a_vector_stands_for_its_components(log):
    axes = [f"/device/state.measured_force.{axis}" for axis in "xyz"]
    assert names_of(log, "measured_force") == names_of(log, "/device/state.measured_force") == axes


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (
            "time_ns",
            r"several topics have time_ns; say which: /device/command\.time_ns, /device/state\.time_ns",
        ),
        ("measured_forse.z", r"no signal measured_forse\.z; did you mean measured_force\.z"),
        ("zzzz", r"no signal zzzz\n/device/command has"),
        ("text", r"/events\.text is no number but text; numbers are: sequence, time_ns, level"),
    ],
)
def test_a_name_that_stands_for_none_or_several_is_refused_with_what_there_is(log, name, said):
    with pytest.raises(RecordingError, match=said):
        names_of(log, name)


def test_an_unknown_name_is_told_with_every_signal_of_every_topic(log, capsys):
    assert run(["log", "plot", str(log), "zzzz"]) == 1
    told = capsys.readouterr().err
    assert "/loop/timing has sequence, time_ns, lateness_ns" in told
    assert "/teaching/arbitration has time_ns, stage, C" in told


def test_short_names_are_columns_unless_two_signals_share_one():
    a, b, c = (
        Signal(topic=t, column=x, unit="", is_whole=False) for t, x in (("/a", "x"), ("/b", "x"), ("/b", "y"))
    )
    assert short_names([a, b, c]) == {"/a.x": "/a.x", "/b.x": "/b.x", "/b.y": "y"}


def test_a_thinned_curve_keeps_every_peak(tmp_path):
    cycles = 5 * BINS
    path = write(tmp_path / "long.mcap", cycles, change=at("/device/state", 7654, 10, 99.0))
    (curve,) = plot.read(path, ["measured_force.z"])
    assert len(curve.values) == 2 * BINS
    assert curve.largest == np.nanmax(curve.values) == 99.0
    assert curve.time_s[np.nanargmax(curve.values)] == pytest.approx(7.654, abs=cycles / BINS * 1e-3)
    assert np.nanmin(curve.values) == curve.smallest == 3.0


def test_a_short_curve_is_kept_as_it_is(log):
    (curve,) = plot.read(log, ["reference_velocity.x"], 0.1, 0.2)
    np.testing.assert_array_equal(curve.time_s, np.arange(100, 200) / 1000)
    assert curve.values.tolist() == [0.1] * 100


def test_a_line_breaks_where_messages_are_missing(tmp_path):
    path = write(tmp_path / "gap.mcap", lost=set(range(100, 150)))
    (curve,) = plot.read(path, ["measured_force.z"])
    assert curve.time_s[np.isnan(curve.values)].tolist() == [0.150]


def test_an_envelope_leaves_out_what_is_not_finite():
    envelope = Envelope(0.0, 2.0, bins=2)
    envelope.add(np.array([0.0, 0.5, 0.9, 1.9]), np.array([1.0, np.nan, -4.0, np.inf]))
    time_s, values = envelope.curve()
    assert time_s.tolist() == [0.5, 0.5, 1.5, 1.5]
    np.testing.assert_array_equal(values, [-4.0, 1.0, np.nan, np.nan])


def test_signals_of_one_unit_share_an_axis_and_whole_numbers_have_their_own(log):
    curves = plot.read(log, ["measured_force", "spring_force.x", "C", "stage"])
    groups = [(unit, [curve.signal.column for curve in group]) for unit, group in by_unit(curves)]
    assert groups == [
        ("N", ["measured_force.x", "measured_force.y", "measured_force.z", "spring_force.x"]),
        ("", ["C"]),
        ("", ["stage"]),
    ]


def test_a_range_without_a_message_of_the_signal_says_so(log):
    with pytest.raises(RecordingError, match=r"no message of /events\.level from 0 s to 0\.1 s"):
        plot.read(log, ["/events.level"], 0.0, 0.1)
    with pytest.raises(RecordingError, match=r"outside of 0 to 0\.3 s"):
        plot.read(log, ["C"], 5.0)


def test_a_picture_has_units_a_legend_and_the_same_bytes_each_time(log, tmp_path):
    words = ["log", "plot", str(log), "measured_force", "C", "--output"]
    assert run([*words, str(tmp_path / "a.svg")]) == 0
    assert run([*words, str(tmp_path / "b.svg")]) == 0
    text = (tmp_path / "a.svg").read_text()
    assert text == (tmp_path / "b.svg").read_text()
    shown = re.findall(r">([^<>\n]+)</text>", text)
    for part in ("Force [N]", "C", "measured_force.x", "log.mcap", "Time since the beginning of the log [s]"):
        assert part in shown


def test_a_picture_is_a_png_by_its_suffix_and_no_other_file_is_written_over(log, tmp_path, capsys):
    target = tmp_path / "a.png"
    words = ["log", "plot", str(log), "C", "--output", str(target)]
    assert run(words) == 0
    assert target.read_bytes().startswith(b"\x89PNG")
    assert run(words) == 1
    assert "exists already; give --force" in capsys.readouterr().err
    assert run([*words[:-1], str(tmp_path / "a.gif")]) == 1
    assert "pictures are .png, .svg, .pdf" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


def test_the_terminal_shows_a_chart_for_each_signal(log, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("LINES", "24")
    assert run(["log", "plot", str(log), "measured_force.z", "stage"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
    assert lines[0] == "measured_force.z [N]  smallest 3, largest 3"
    assert any(line.startswith("stage  smallest 0, largest 2") for line in lines)
    assert run(["log", "plot", str(log)]) == 1
    assert "name a signal or more" in capsys.readouterr().err


def test_a_rising_line_runs_from_corner_to_corner():
    lines = render([curve_of(np.linspace(0.0, 1.0, 11))], width=40, height=10).splitlines()[1:-3]
    charts = [line[12:] for line in lines]
    assert charts[-1][0] != "⠀"
    assert charts[0][-1] != "⠀"
    assert charts[0][0] == charts[-1][-1] == "⠀"
    assert all(any(sign != "⠀" for sign in column) for column in zip(*charts, strict=True))


def test_a_peak_of_one_message_is_in_the_terminal():
    values = np.zeros(5000)
    values[3210] = 7.0
    shown = render([curve_of(values)], width=60, height=12).splitlines()
    assert "largest 7" in shown[0]
    assert shown[1][12:].strip("⠀")


def test_steps_stay_steps_in_the_terminal():
    curve = curve_of([0, 0, 1, 1], is_whole=True, unit="")
    shown = render([curve], width=60, height=8).splitlines()[1:-3]
    top = shown[0][12:]
    assert top.index(top.strip("⠀")[0]) == pytest.approx(2 / 3 * len(top), abs=1.5)


def test_times_are_seconds_of_the_log(log):
    (curve,) = plot.read(log, ["/device/state.sequence"])
    assert curve.time_s[1] == MS * 1e-9
