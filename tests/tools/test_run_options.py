"""The configuration of a session: what is refused, what is warned of, and what is built from it."""

import math

import numpy as np
import pytest

from hm_driver.errors import ConfigurationError
from hm_driver.realtime.setpoint import LoopState
from teaching.session import Stage
from teaching.task_file import load_task
from tools.config import load
from tools.config_text import to_dict, to_toml
from tools.run.demonstrator import FIRST_GUESS, build_demonstrator, practised_depths
from tools.run.methods import PRESETS, Method
from tools.run.options import (
    AccumulationOptions,
    ArbitrationKind,
    ArbitrationOptions,
    LearnerKind,
    LearnerOptions,
    PruneRule,
    TeachOptions,
    build_session,
    load_options,
)
from tools.run.request import TeachRequest

WRONG = [
    ("learner", "D", 0.0),
    ("learner", "w_gen", 0.0),
    ("learner", "w_gen", 1.5),
    ("learner", "w_prune", -0.1),
    ("learner", "lam", 0.0),
    ("learner", "lam", 1.1),
    ("learner", "P0", -1.0),
    ("arbitration", "w_th", 0.0),
    ("arbitration", "w_th", 1.0),
    ("arbitration", "d", -0.1),
    ("arbitration", "d", 1.0),
    ("accumulation", "N_acc", 0),
    ("accumulation", "N_acc", 2_000_000),
    ("accumulation", "downsample", 0),
    ("accumulation", "downsample", 1001),
    ("session", "practice", -1.0),
    ("session", "hindsight", -0.1),
    ("correction", "radius", 0.0),
    ("learner.multi", "levels", 0),
    ("learner.adaptation", "tau", 2.0),
    ("arbitration.error", "memory", 0.0),
    ("arbitration.success", "tolerance", -1.0),
    ("arbitration.success", "high", 1.0),
    ("demonstrator", "speed", 0.0),
    ("modes", "inertia", 1.0),
    ("limits", "velocity_trip", 0.5),
    ("timing", "rate_hz", 10.0),
    ("watch", "heartbeat_s", -1.0),
    ("geometry", "r0", 0.1),
]


def test_the_defaults_are_the_papers_where_it_gives_a_value():
    options = TeachOptions()
    assert (options.learner.D, options.learner.w_gen, options.learner.w_prune) == (400.0, 0.8, 0.9)
    assert options.learner.lam == 1.0
    assert (options.arbitration.w_th, options.arbitration.d) == (0.5, 0.05)
    assert options.accumulation.N_acc == 1000
    assert options.task == "paper"


@pytest.mark.parametrize(("group", "name", "value"), WRONG)
def test_a_wrong_value_names_its_group_and_field_and_the_file(group, name, value, tmp_path):
    path = tmp_path / "wrong.toml"
    path.write_text(f"[{group}]\n{name} = {value}\n")
    with pytest.raises(ConfigurationError) as caught:
        load(TeachOptions, path)
    assert caught.value.field == f"{group}.{name}"
    assert str(path) in str(caught.value)
    assert str(value) in str(caught.value) or f"{value:g}" in str(caught.value)


@pytest.mark.parametrize("text", ["[learner]\nw_gne = 0.8\n", "[learner]\nw_gen = 'a'\n", "[lerner]\n"])
def test_a_misspelt_key_and_a_wrong_type_are_refused(text, tmp_path):
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=r"wrong\.toml"):
        load(TeachOptions, path)


def test_the_configuration_survives_its_own_file(tmp_path):
    options = TeachOptions(learner=LearnerOptions(w_gen=0.7, prune=PruneRule.PAPER), init_timeout_s=12.0)
    path = tmp_path / "config.toml"
    path.write_text(to_toml(options))
    assert load(TeachOptions, path) == options
    assert to_dict(options)["learner"]["prune"] == "paper"


# Warnings


def test_the_defaults_contradict_nothing():
    assert TeachOptions().warnings() == []


def test_thresholds_under_which_teaching_on_never_hands_over_are_told():
    options = TeachOptions(
        arbitration=ArbitrationOptions(w_th=0.85, d=0.02), learner=LearnerOptions(w_gen=0.8)
    )
    (text,) = [text for text in options.warnings() if "w_th" in text]
    assert "0.85" in text
    assert "0.8" in text
    assert "choose" in text


def test_a_blend_that_reaches_above_the_generation_threshold_is_told():
    options = TeachOptions(arbitration=ArbitrationOptions(w_th=0.78, d=0.1))
    assert any("w_th + d/2 = 0.83" in text for text in options.warnings())


@pytest.mark.parametrize(
    ("learner", "problem"),
    [
        (LearnerOptions(prune=PruneRule.PAPER), "w_prune^4"),
        (LearnerOptions(w_gen=0.95), "pruned as soon as it is made"),
    ],
)
def test_generation_and_pruning_that_undo_each_other_are_told(learner, problem):
    (text,) = TeachOptions(learner=learner).warnings()
    assert problem in text


@pytest.mark.parametrize("rule", [PruneRule.OVERLAP, PruneRule.NEVER])
def test_the_other_readings_of_the_pruning_rule_contradict_nothing(rule):
    assert TeachOptions(learner=LearnerOptions(prune=rule)).warnings() == []


# What is built


def test_a_session_is_built_as_the_options_say():
    options = TeachOptions(
        accumulation=AccumulationOptions(N_acc=30, downsample=3), arbitration=ArbitrationOptions(w_th=0.4)
    )
    session = build_session(options, load_task("paper"), np.random.default_rng(1))
    assert session.stage is Stage.PRACTICE
    assert session.w_th == 0.4
    assert session.options == options.session
    assert session.learner.n_models == 0
    assert session._accumulator.n_acc == 30
    assert session._accumulator.downsample == 3


@pytest.mark.parametrize("rule", PruneRule)
def test_every_reading_of_the_pruning_rule_can_be_built(rule):
    assert LearnerOptions(prune=rule).build().n_models == 0


def test_the_streams_of_a_seed_are_its_own_and_independent(tmp_path):
    def draw(seed):
        request = TeachRequest(options=TeachOptions(), task=load_task("paper"), seed=seed, output=tmp_path)
        shuffle, hand, emulator = request.streams()
        return shuffle.random(), hand.random(), emulator

    assert draw(1) == draw(1)
    one, two = draw(1), draw(2)
    assert all(a != b for a, b in zip(one, two, strict=True))
    assert one[0] != one[1]


# The demonstrator's practice


def test_practice_gives_one_depth_a_colour_with_an_error_of_its_own():
    task = load_task("paper")
    exact = practised_depths(task, 0.0, np.random.default_rng(1))
    needed = [task.reference_force / thing.stiffness for thing in task.objects]
    assert exact == pytest.approx(needed)
    errors = np.array(
        [
            np.array(practised_depths(task, 0.03, np.random.default_rng(seed))) / needed - 1.0
            for seed in range(200)
        ]
    )
    assert errors.std() == pytest.approx(0.03, rel=0.15)
    assert abs(errors.mean()) < 0.005


def test_a_novice_knows_one_first_guess_for_all_colours():
    task, options = load_task("paper"), TeachOptions()
    novice = type(options.demonstrator)(practised=False)
    hand = build_demonstrator(task, novice, np.random.default_rng(1), handle=(0.0, 0.0, 0.1))
    assert hand._depths == [FIRST_GUESS]


def test_the_demonstrator_is_handed_areas_and_depths_but_no_task():
    task, options = load_task("paper"), TeachOptions()
    hand = build_demonstrator(task, options.demonstrator, np.random.default_rng(1), handle=(0.0, 0.0, 0.1))
    stiffness = {thing.stiffness for thing in task.objects}
    held = [value for value in vars(hand).values() if isinstance(value, (int, float))]
    assert not stiffness & {value for value in held if not math.isclose(value, 0.0)}
    assert len(hand._areas) == len(hand._depths) == len(task.objects)
    assert not [value for value in vars(hand).values() if value is task or value in task.objects]


# Methods


@pytest.mark.parametrize("method", Method)
def test_every_method_can_be_loaded_and_built_and_contradicts_nothing(method):
    merged = load_options(None, {"method": method.value})
    assert merged.value.method is method
    assert merged.value.warnings() == []
    session = build_session(merged.value, load_task("paper"), np.random.default_rng(1))
    assert session.learner.n_models == 0
    for key in PRESETS[method.value]:
        assert merged.sources[key] == f"method {method.value}"


def test_the_method_of_the_paper_is_the_default_and_its_options_are_the_defaults():
    assert load_options().value == load_options(None, {"method": "paper"}).value == TeachOptions()


def test_what_a_file_or_the_command_line_gives_stands_above_the_method(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text('method = "confident"\n[arbitration]\ndoubt = 0.4\n[session]\nflush = 7\n')
    merged = load_options(path, {"session.flush": "8"})
    options = merged.value
    assert options.method is Method.CONFIDENT
    assert options.arbitration.kind is ArbitrationKind.CONFIDENCE
    assert (options.arbitration.doubt, options.session.flush) == (0.4, 8)
    assert merged.sources["arbitration.doubt"] == str(path)
    assert merged.sources["arbitration.kind"] == "method confident"
    assert load_options(path, {"method": "paper"}).value.arbitration.kind is ArbitrationKind.PAPER


def test_the_configuration_of_a_method_survives_its_own_file(tmp_path):
    options = load_options(None, {"method": "confident"}).value
    path = tmp_path / "config.toml"
    path.write_text(to_toml(options))
    assert load_options(path).value == options


def test_a_misspelt_method_is_refused_with_a_suggestion():
    with pytest.raises(ConfigurationError, match="did you mean confident"):
        load_options(None, {"method": "confidant"})


@pytest.mark.parametrize("learner", LearnerKind)
@pytest.mark.parametrize("arbitration", ArbitrationKind)
def test_every_learner_goes_with_every_arbitration(learner, arbitration):
    task = load_task("paper")
    overrides = {"learner.kind": learner.value, "arbitration.kind": arbitration.value}
    session = build_session(load_options(None, overrides).value, task, np.random.default_rng(1))
    x, y, z = task.to_handle(0.05, 0.05, -0.03)
    for _ in range(500):
        tick = session.tick(LoopState(measured_x=x, measured_y=y, measured_z=z), 0.01)
    assert 0.0 <= tick.C <= 1.0
    assert tick.stage is Stage.TEACHING


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        ({"arbitration.kind": "error"}, "uncoupled"),
        ({"arbitration.kind": "success"}, "uncoupled"),
        ({"session.coupling": "uncoupled", "correction.insist_force": "8"}, "has no effect"),
    ],
)
def test_what_does_not_go_together_is_told_with_its_consequence(overrides, told):
    (text,) = load_options(None, overrides).value.warnings()
    assert told in text


def test_the_buffer_waits_as_long_as_hindsight_asks():
    options = load_options(None, {"session.hindsight": "0.25"}).value
    session = build_session(options, load_task("paper"), np.random.default_rng(1))
    assert session._accumulator.hindsight == 25
