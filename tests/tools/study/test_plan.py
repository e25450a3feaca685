"""Study files: what they describe, and how they are refused."""

from pathlib import Path

import numpy as np
import pytest

from hm_driver.errors import ConfigurationError
from teaching import task_file
from tools.cli.study import _SHIPPED
from tools.study.plan import load_study, session_seeds

FILE = """
format = 1
title = "A test"
seed = 3
repeats = 2

[base]
session.practice = 0.5
accumulation = { N_acc = 150 }

[levels.demonstrator]
expert = {}
hasty = { demonstrator.speed = 0.3, "demonstrator.lag" = 0.25 }

[cross]
method = ["paper", "confident"]
demonstrator = ["expert", "hasty"]

[[sensitivity]]
at = { method = "confident" }
repeats = 3
vary = { learner.w_gen = [0.5, 0.6], "learner.multi.levels" = [1, 2] }
"""


def study_of(tmp_path, text=FILE):
    path = tmp_path / "study.toml"
    path.write_text(text)
    return load_study(path)


def problem_of(tmp_path, text):
    with pytest.raises(ConfigurationError) as caught:
        study_of(tmp_path, text)
    assert str(tmp_path / "study.toml") in str(caught.value)
    return str(caught.value)


def test_every_combination_and_every_value_alone_is_a_case(tmp_path):
    cases = study_of(tmp_path).cases
    assert [case.name for case in cases] == [
        "method=paper demonstrator=expert",
        "method=paper demonstrator=hasty",
        "method=confident demonstrator=expert",
        "method=confident demonstrator=hasty",
        "method=confident demonstrator=expert learner.w_gen=0.5",
        "method=confident demonstrator=expert learner.w_gen=0.6",
        "method=confident demonstrator=expert learner.multi.levels=1",
        "method=confident demonstrator=expert learner.multi.levels=2",
    ]
    assert [case.part for case in cases] == ["cross"] * 4 + ["learner.w_gen"] * 2 + [
        "learner.multi.levels"
    ] * 2
    assert [len(case.jobs) for case in cases] == [2] * 4 + [3] * 4


def test_options_come_from_base_levels_and_axes_over_the_methods_defaults(tmp_path):
    cases = study_of(tmp_path).cases
    hasty = cases[3].jobs[0].options
    assert hasty.session.practice == 0.5
    assert hasty.accumulation.N_acc == 150
    assert (hasty.demonstrator.speed, hasty.demonstrator.lag) == (0.3, 0.25)
    assert hasty.method.value == "confident"
    assert hasty.learner.kind.value == "multi"
    assert cases[6].jobs[0].options.learner.multi.levels == 1


def test_the_seeds_are_those_of_every_case_and_stay_when_there_are_more():
    assert session_seeds(3, 5)[:2] == session_seeds(3, 2)
    assert len(set(session_seeds(3, 1000))) == 1000
    child = np.random.SeedSequence(3).spawn(2)[1]
    assert session_seeds(3, 2)[1] == child.generate_state(1)[0]


def test_all_cases_share_their_seeds_and_no_session_is_run_twice(tmp_path):
    study = study_of(tmp_path, FILE.replace("[0.5, 0.6]", "[0.5, 0.8]"))
    seeds = [[job.seed for job in case.jobs][:2] for case in study.cases]
    assert all(one == seeds[0] for one in seeds)
    keys = [job.key for case in study.cases for job in case.jobs]
    assert len(study.jobs) == len(set(keys)) < len(keys)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("format = 1", "format = 2", ["format", "another version", "docs/study.md"]),
        ("format = 1\n", "", ["format", "missing"]),
        ("repeats = 2", "repeats = 0", ["repeats", "whole number"]),
        ("repeats = 2", "repets = 2", ["repets", "did you mean repeats?"]),
        ("seed = 3", 'seed = "a"', ["seed", "whole number"]),
        ("session.practice = 0.5", "session.practise = 0.5", ["session.practise", "did you mean"]),
        ("session.practice = 0.5", "session.practice = -0.5", ["session.practice", "must not be negative"]),
        ("session.practice = 0.5", 'session.practice = "soon"', ["session.practice", "finite number"]),
        ('["paper", "confident"]', '["paper", "confidant"]', ["method", "confidant"]),
        ('["expert", "hasty"]', '["expert", "hastey"]', ["demonstrator", "hastey", "did you mean hasty?"]),
        ('["expert", "hasty"]', '["expert", "expert"]', ["demonstrator", "twice"]),
        ('["expert", "hasty"]', '"expert"', ["cross.demonstrator", "array"]),
        ("[0.5, 0.6]", "[0.5, 1.6]", ["w_gen", "1.6"]),
        ("[0.5, 0.6]", "[]", ["w_gen", "array"]),
        ("repeats = 3", "repeat = 3", ["sensitivity[0].repeat", "did you mean"]),
        ("vary =", "at2 =", ["sensitivity[0].at2"]),
        ("[[sensitivity]]", "[sensitivity]", ["sensitivity", "[[sensitivity]]"]),
        ("seed = 3", "seed =", ["TOML"]),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_by_name_and_key(tmp_path, old, new, words):
    assert old in FILE
    problem = problem_of(tmp_path, FILE.replace(old, new, 1))
    for word in words:
        assert word in problem


def test_an_option_below_the_name_of_levels_can_be_varied_too(tmp_path):
    more = "demonstrator.lag = [0.1, 0.4]"
    text = FILE.replace("vary = { learner.w_gen = [0.5, 0.6],", "vary = { " + more + ",")
    cases = study_of(tmp_path, text).cases
    lags = [case.jobs[0].options.demonstrator.lag for case in cases if case.part == "demonstrator.lag"]
    assert lags == [0.1, 0.4]


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match=r"none\.toml: file: cannot be read"):
        load_study(tmp_path / "none.toml")


def test_a_task_file_beside_the_study_is_found(tmp_path):
    shipped = Path(task_file.__file__).parent / "tasks" / "turned.toml"
    (tmp_path / "mine.toml").write_bytes(shipped.read_bytes())
    study = study_of(tmp_path, 'format = 1\nrepeats = 1\n[cross]\ntask = ["mine.toml"]\n')
    assert study.cases[0].jobs[0].task.name
    assert study.cases[0].name == "task=mine.toml"


@pytest.mark.parametrize("path", sorted(_SHIPPED.glob("*.toml")), ids=lambda path: path.stem)
def test_the_shipped_studies_can_be_run(path):
    assert load_study(path).jobs
