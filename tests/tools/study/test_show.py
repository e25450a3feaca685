"""What is shown of a study: tables, pictures and JSON."""

import json
import math

import numpy as np
import pytest
from scipy import stats

from tools.cli.main import run as hm
from tools.study.plan import load_study
from tools.study.run import run_study
from tools.study.statistics import load_results, mean_of, varying_axes
from tools.study.store import COUNTS, FIGURES, Store

FILE = """
format = 1
title = "Shown"
repeats = 4
[cross]
method = ["paper", "confident"]
task = ["paper", "turned"]
[[sensitivity]]
at = { method = "confident" }
vary = { "learner.w_gen" = [0.3, 0.5, 0.6], "session.flush" = [10, 30] }
"""


def made_up(job):
    rng = np.random.default_rng(job.seed)
    row = {name: float(value) for name, value in zip(FIGURES, rng.random(len(FIGURES)), strict=True)}
    row |= {name: int(rng.integers(1, 100)) for name in COUNTS}
    row["autonomy_s"] = math.nan if job.options.method.value == "paper" else 50.0 + rng.random()
    return row | {
        "key": job.key,
        "seed": job.seed,
        "ended": "",
        "curve_s": [10.0, 20.0 + rng.random()],
        "curve_error": [5.0 + rng.random(), 2.0],
        "curve_models": [10, 20],
    }


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    path = tmp_path_factory.mktemp("study") / "study.toml"
    path.write_text(FILE)
    run_study(load_study(path), path.parent / "out", workers=1, run=made_up)
    return path.parent / "out"


def test_the_interval_is_students():
    values = np.array([1.0, 2.0, 4.0, np.nan])
    mean = mean_of(values)
    low, high = stats.t.interval(0.95, 2, loc=values[:3].mean(), scale=stats.sem(values[:3]))
    assert mean.n == 3
    assert (mean.low, mean.high) == pytest.approx((low, high))
    assert mean_of(np.array([2.0])).n == 1
    assert math.isnan(mean_of(np.array([np.nan])).mean)


def test_each_case_has_its_sessions_and_the_error_holds_between_updates(directory):
    results = load_results(Store(directory))
    assert [case.sessions for case in results.cross] == [4] * 4
    assert varying_axes(results.cross) == ["method", "task"]
    assert {part: len(cases) for part, cases in results.sensitivity.items()} == {
        "learner.w_gen": 3,
        "session.flush": 2,
    }
    case = results.cross[0]
    assert case.share_autonomous == 0.0
    assert case.figures["autonomy_s"].n == 0
    assert results.cross[2].share_autonomous == 1.0
    at = dict(zip(case.curve_s, case.curve_error.T, strict=True))
    assert np.isnan(at[9.0]).all()
    assert (at[15.0] > 5.0).all()
    assert (at[21.0] == 2.0).all()


def test_tables_and_pictures_are_made(directory, tmp_path, capsys):
    assert hm(["study", "show", str(directory), "--pictures", str(tmp_path / "pictures")]) == 0
    out = capsys.readouterr().out
    assert out.startswith("Shown\n")
    assert "learner.w_gen" in out
    assert " ± " in out
    for name in ("errors", "curves", "control", "sensitivity"):
        picture = tmp_path / "pictures" / f"study-{name}.svg"
        assert picture.stat().st_size < 200_000
        assert picture.read_text().rstrip().endswith("</svg>")


def test_the_pictures_of_the_same_results_are_the_same(directory, tmp_path, capsys):
    for name in ("one", "two"):
        hm(["study", "show", str(directory), "--pictures", str(tmp_path / name)])
    capsys.readouterr()
    for picture in (tmp_path / "one").iterdir():
        assert picture.read_bytes() == (tmp_path / "two" / picture.name).read_bytes()


def test_json_has_all_figures_and_null_for_what_there_is_not(directory, tmp_path, capsys):
    hm(["study", "show", str(directory), "--pictures", str(tmp_path), "--json"])
    shown = json.loads(capsys.readouterr().out)
    case = shown["cross"][0]
    assert case["settings"] == {"method": "paper", "task": "paper"}
    assert case["figures"]["autonomy_s"] == {"mean": None, "half": None, "n": 0}
    assert 0.0 < case["figures"]["grid_overall_mean"]["mean"] < 1.0


def test_a_directory_without_results_says_how_to_make_some(tmp_path, capsys):
    assert hm(["study", "show", str(tmp_path / "none")]) == 2
    assert "hm study run" in capsys.readouterr().err


def test_the_list_names_what_is_shipped(capsys):
    assert hm(["study", "list", "--json"]) == 0
    names = {study["name"] for study in json.loads(capsys.readouterr().out)["studies"]}
    assert "quick" in names
