"""Running a study: results that depend on nothing but the file, resumed runs, workers that die."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from functools import partial

import numpy as np
import pytest

from hm_driver.errors import ConfigurationError
from tools.cli.main import run as hm
from tools.study.plan import load_study
from tools.study.row import run_session
from tools.study.run import run_study
from tools.study.store import CURVES, SCHEMA, Store

FILE = """
format = 1
repeats = 3
[base]
accumulation.N_acc = 150
session.practice = 0.2
session.give_up = 3.0
session.examination = 0.2
session.autonomous_spacing = 0.4
[cross]
method = ["paper", "button"]
"""


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(FILE)
    return load_study(path)


def same(one, other):
    assert list(one) == list(other) == SCHEMA.names
    for name in one:
        for a, b in zip(one[name], other[name], strict=True):
            np.testing.assert_array_equal(a, b)
    return True


def empty_row(job):
    """A row without a session, for what is about processes."""
    return dict.fromkeys(SCHEMA.names, 0) | {
        "key": job.key,
        "seed": job.seed,
        "ended": "",
        **{name: [] for name in CURVES},
    }


def dying(doomed, job):
    if job.key in doomed:
        os._exit(9)
    return empty_row(job)


def dying_once(flag, job):
    if not flag.exists():
        flag.touch()
        os._exit(9)
    return empty_row(job)


def test_the_result_depends_on_neither_workers_nor_batches(tmp_path, study):
    run_study(study, tmp_path / "one", workers=1, batch=5)
    outcome = run_study(study, tmp_path / "two", workers=2, batch=1)
    assert (outcome.sessions, outcome.ran, outcome.lost) == (6, 6, ())
    table = Store(tmp_path / "one").table()
    assert same(table, Store(tmp_path / "two").table())
    assert set(table["key"]) == {job.key for job in study.jobs}
    assert not any(table["ended"])
    assert (table["session_s"] > 3.0).all()


def test_a_killed_study_goes_on_where_it_stood(tmp_path, study):
    output = tmp_path / "killed"
    command = [sys.executable, "-m", "tools.cli.main", "study", "run", str(study.path)]
    process = subprocess.Popen(
        [*command, "--output", str(output), "--jobs", "1", "--batch", "1"], stderr=subprocess.DEVNULL
    )
    while not list(output.glob("parts/*.parquet")):
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = len(Store(output).keys())
    assert 1 <= before < 6
    outcome = run_study(study, output, workers=1)
    assert (outcome.were_there, outcome.ran) == (before, 6 - before)
    run_study(study, tmp_path / "whole", workers=1)
    assert same(Store(output).table(), Store(tmp_path / "whole").table())
    assert run_study(study, output, workers=1).ran == 0


def test_a_session_whose_worker_dies_is_tried_again_then_named_and_the_rest_goes_on(tmp_path, study):
    doomed = {job.key for job in study.cases[1].jobs[:2]}
    outcome = run_study(study, tmp_path / "out", workers=2, batch=2, run=partial(dying, doomed))
    assert {lost.job.key for lost in outcome.lost} == doomed
    assert Store(tmp_path / "out").keys() == {job.key for job in study.jobs} - doomed
    assert outcome.ran == 4


def test_a_worker_that_dies_once_costs_nothing_but_time(tmp_path, study):
    run = partial(dying_once, tmp_path / "flag")
    outcome = run_study(study, tmp_path / "out", workers=2, batch=2, run=run)
    assert (outcome.ran, outcome.lost) == (6, ())


@pytest.mark.parametrize("method", ["paper", "confident"])
def test_a_row_says_of_a_session_what_hm_teach_says_of_it(tmp_path, method, capsys):
    base = FILE.split("[base]")[1].split("[cross]", maxsplit=1)[0].replace(" ", "").split()
    (tmp_path / "study.toml").write_text(FILE.replace('["paper", "button"]', f'["{method}"]'))
    job = load_study(tmp_path / "study.toml").jobs[0]
    row = run_session(job)
    words = [word for option in base for word in ("--set", option)]
    output = ["--output", str(tmp_path), "--json"]
    assert hm(["teach", "--fast", "--method", method, "--seed", str(row["seed"]), *words, *output]) == 0
    told = json.loads(capsys.readouterr().out)
    assert row["updates"] > 0
    for name in ("updates", "models", "models_added", "models_pruned", "samples", "hand_overs"):
        assert row[name] == told[name], name
    figures = {
        name: told[name] for name in ("coverage", "human_share", "share_wrong", "auc_std", "auc_w_max")
    }
    for where in ("overall", "inside", "border"):
        for part in ("mean", "p95", "max"):
            figures[f"grid_{where}_{part}"] = told["grid"][where][part]
            figures[f"run_{where}_{part}"] = told["run"]["force"][where][part]
    figures["teaching_s"] = told["teaching_from_first_sample_s"]
    for name, value in figures.items():
        assert row[name] == pytest.approx(value, rel=1e-6, abs=1e-6, nan_ok=True), name


def test_a_session_that_trips_is_told_in_its_row(study):
    job = study.jobs[0]
    limits = dataclasses.replace(job.options.limits, velocity_z=0.02)
    row = run_session(dataclasses.replace(job, options=dataclasses.replace(job.options, limits=limits)))
    assert row["ended"].startswith("SafetyTrip: ")
    assert row["updates"] == 0


def test_a_wider_study_keeps_the_sessions_that_are_there(tmp_path, study):
    run_study(study, tmp_path / "out", workers=1, run=empty_row)
    study.path.write_text(FILE.replace("repeats = 3", "repeats = 5"))
    outcome = run_study(load_study(study.path), tmp_path / "out", workers=1, run=empty_row)
    assert (outcome.were_there, outcome.ran) == (6, 4)


def test_results_of_another_version_are_refused(tmp_path, study):
    run_study(study, tmp_path / "out", workers=1, run=empty_row)
    description = tmp_path / "out" / "study.json"
    description.write_text(json.dumps(json.loads(description.read_text()) | {"format": 2}))
    with pytest.raises(ConfigurationError, match=r"another version.*another directory"):
        run_study(study, tmp_path / "out", workers=1)


def test_a_directory_of_other_things_is_not_written_into(tmp_path, study):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("")
    with pytest.raises(ConfigurationError, match="no results of a study"):
        run_study(study, tmp_path / "out", workers=1)


def test_a_damaged_part_is_named_with_what_to_do(tmp_path, study):
    run_study(study, tmp_path / "out", workers=1, run=empty_row)
    part = next((tmp_path / "out" / "parts").iterdir())
    part.write_bytes(part.read_bytes()[:50])
    with pytest.raises(ConfigurationError, match=r"parquet: cannot be read.*remove the file"):
        Store(tmp_path / "out").table()


@pytest.mark.parametrize("backend", ["dask", "ray"])
def test_a_backend_that_is_not_there_says_what_to_install(tmp_path, study, backend, monkeypatch, capsys):
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *_: None if name != "joblib" else object())
    code = hm(["study", "run", str(study.path), "--output", str(tmp_path / "out"), "--backend", backend])
    assert code == 2
    assert '.venv/bin/pip install ".[' in capsys.readouterr().err


def test_an_address_without_a_cluster_is_refused(tmp_path, study, capsys):
    words = ["study", "run", str(study.path), "--output", str(tmp_path / "out"), "--address", "tcp://here:1"]
    assert hm(words) == 2
    assert "--backend dask or ray" in capsys.readouterr().err
