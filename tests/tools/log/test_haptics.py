import json
import math

import numpy as np
import oscillating_arm
import pytest
from log_bench import write

from hm_driver.errors import RecordingError
from hm_driver.recording.editing import cut, merge
from hm_driver.recording.reader import Recording
from tools.cli.main import run
from tools.log.cycles import PIECE, read_cycles
from tools.log.energy import SOURCES
from tools.log.haptics import analyse
from tools.log.spectrum import WINDOW, Welch


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return oscillating_arm.write(tmp_path_factory.mktemp("log") / "arm.mcap")


@pytest.fixture(scope="module")
def felt(log):
    return analyse(log)


def rendered(felt, kind, axis="x"):
    return next(one for one in felt.rendered if (one.kind, one.axis) == (kind, axis))


def test_a_spring_is_found_with_its_stiffness_and_damping(felt):
    spring = rendered(felt, "position spring")
    assert spring.stiffness.value == pytest.approx(oscillating_arm.STIFFNESS, rel=0.01)
    assert spring.damping.value == pytest.approx(oscillating_arm.DAMPING, rel=0.01)
    assert 0.0 < spring.stiffness.half < 0.01 * oscillating_arm.STIFFNESS
    assert (spring.asked_stiffness, spring.asked_damping) == pytest.approx((2000.0, 120.0))
    assert spring.mass is None
    assert spring.r2 > 0.999
    assert spring.time_s == pytest.approx(6.0, abs=0.05)


def test_free_motion_shows_the_mass_and_the_damping(felt):
    free = rendered(felt, "free")
    assert free.mass.value == pytest.approx(oscillating_arm.MASS, rel=0.01)
    assert free.damping.value == pytest.approx(oscillating_arm.FREE_DAMPING, abs=0.3)
    assert free.stiffness is None


def test_the_drawn_samples_lie_on_the_spring(felt):
    spring = rendered(felt, "position spring")
    slope = np.polyfit(spring.deflection, spring.restoring, 1)[0]
    assert slope == pytest.approx(spring.stiffness.value, rel=0.01)


def test_what_did_not_move_is_not_estimated(felt):
    assert {one.axis for one in felt.rendered} == {"x"}


def test_without_a_configuration_the_mass_is_estimated_beside_the_spring(tmp_path):
    felt = analyse(oscillating_arm.write(tmp_path / "bare.mcap", seconds=10.0, modes=None, release=1.0))
    spring = rendered(felt, "position spring")
    assert spring.mass.value == pytest.approx(oscillating_arm.MASS, rel=0.1)
    assert spring.stiffness.value == pytest.approx(oscillating_arm.STIFFNESS, rel=0.05)
    assert (felt.mass, felt.energy.dissipated, spring.asked_stiffness) == (None, None, None)


def test_a_saturated_spring_is_left_out(tmp_path):
    modes = oscillating_arm.MODES | {"position_force_max": 6.0}
    felt = analyse(oscillating_arm.write(tmp_path / "weak.mcap", modes=modes, release=1.0))
    assert all(one.time_s < 6.0 for one in felt.rendered)


def test_the_energy_of_the_hand_goes_into_motion_and_damping(felt):
    work = dict(zip(SOURCES, felt.energy.work[-1], strict=True))
    assert work["hand"] > 0.0
    assert work["position springs"] < 0.0
    assert work["assist"] == work["bias force"] == 0.0
    # the drag of free motion takes the rest: 5 N s/m times the square of the velocity
    assert felt.energy.dissipated > 0.0
    assert np.all(np.diff(felt.energy.time_s) > 0.0)


def test_an_undamped_mass_dissipates_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(oscillating_arm, "FREE_DAMPING", 0.0)
    felt = analyse(oscillating_arm.write(tmp_path / "free.mcap", release=0.0, noise=0.0))
    assert felt.energy.dissipated == pytest.approx(0.0, abs=0.01 * felt.energy.work[-1][0] + 0.02)


def test_a_spectrum_has_the_lines_of_the_push(felt):
    assert felt.force.strongest(0.5)[0] == pytest.approx(1.3, abs=0.25)
    assert felt.force.rms(0.5, 10.0)[0] == pytest.approx(math.sqrt(0.5 * (8.0**2 + 4.0**2)), rel=0.03)
    assert felt.force.rms(50.0, math.inf)[0] == pytest.approx(0.02, rel=0.1)


def test_a_spectrum_of_pieces_is_that_of_the_whole():
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, 2.0, (4 * WINDOW, 1))
    whole, pieces = Welch(), Welch()
    whole.add(noise, 1000.0)
    for half in np.split(noise, 2):
        pieces.add(half, 1000.0)
    for welch in (whole, pieces):
        assert welch.spectrum().rms(0.0, math.inf)[0] == pytest.approx(2.0, rel=0.05)
    pieces.add(np.full((WINDOW, 1), np.nan), 1000.0)
    assert pieces.spectrum().rms(0.0, math.inf)[0] == pytest.approx(2.0, rel=0.05)
    assert Welch().spectrum() is None


def test_cycles_come_in_pieces_without_gaps(tmp_path):
    path = oscillating_arm.write(tmp_path / "gap.mcap", seconds=3.0, lost={1000, 1001, 2500})
    with Recording(path) as recording:
        pieces = list(read_cycles(recording))
        assert [len(piece.time_s) for piece in pieces] == [1000, 1498, 499]
        assert [piece.time_s[0] for piece in pieces] == [0.0, 1.002, 2.501]
        assert sum(len(piece.time_s) for piece in read_cycles(recording, 0.5, 1.5)) == 998
    assert PIECE > 3000


def test_cycles_of_merged_logs_stay_apart(log, tmp_path):
    cut(log, tmp_path / "a.mcap", 0.0, 1.0)
    cut(log, tmp_path / "b.mcap", 2.0, 3.0)
    merge([tmp_path / "b.mcap", tmp_path / "a.mcap"], tmp_path / "both.mcap")
    with Recording(tmp_path / "both.mcap") as recording:
        starts = [(piece.time_s[0], len(piece.time_s)) for piece in read_cycles(recording)]
    assert starts == [(0.0, 1000), (2.0, 1000)]


def test_the_command_prints_draws_and_gives_json(log, tmp_path, capsys):
    picture = tmp_path / "felt.svg"
    assert run(["log", "haptics", str(log), "--output", str(picture)]) == 0
    told = capsys.readouterr().out
    for part in (
        "position spring, x",
        "N/m (asked 2000)",
        "free, x",
        "work of the hand",
        "dissipated",
        "rms, 2 to",
    ):
        assert part in told
    shown = picture.read_text()
    for part in ("Rendered springs", "Force [N/√Hz]", "Position [mm/√Hz]", "Work since then [J]"):
        assert part in shown
    assert run(["log", "haptics", str(log), "--json", "--start", "1", "--end", "9"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["rendered"][0]["stiffness_n_per_m"]["value"] == pytest.approx(2000.0, rel=0.02)
    assert set(found["work_j"]) == set(SOURCES)
    assert run(["log", "haptics", str(log), "--start", "99"]) == 1
    assert "outside of 0 to" in capsys.readouterr().err


def test_a_short_log_says_what_it_is_too_short_for(tmp_path, capsys):
    log = write(tmp_path / "short.mcap")
    assert run(["log", "haptics", str(log), "--output", str(tmp_path / "a.png")]) == 0
    told = capsys.readouterr().out
    assert "no spring was engaged, and nothing moved, for long enough" in told
    assert "too short: 4096 cycles" in told
    cut(log, tmp_path / "events.mcap", topics=["/events"])
    with pytest.raises(RecordingError, match="no channel /device/state; there are: /events"):
        analyse(tmp_path / "events.mcap")
