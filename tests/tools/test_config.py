import math
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hm_driver.errors import ConfigurationError
from tools.config import COMMAND_LINE, DEFAULT, load, merge, parse_overrides
from tools.config_text import documentation, to_dict, to_toml


class Feedback(Enum):
    VISUAL = "visual"
    RENDERED = "rendered"


@dataclass(frozen=True, slots=True, kw_only=True)
class Learner:
    w_gen: float = 0.8
    """Activation below which a model is made [1]."""
    samples: int = 1000
    """Samples of one update."""

    def __post_init__(self):
        if not 0.0 < self.w_gen < 1.0:
            raise ConfigurationError("w_gen", f"{self.w_gen:g} is outside 0 to 1")


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    name: str
    stiffness: float = 100.0

    def __post_init__(self):
        if self.stiffness <= 0.0:
            raise ConfigurationError("stiffness", f"{self.stiffness:g} N/m must be above 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    seed: int = 1
    label: str = "session"
    practice_s: float = 0.0
    pause_s: float | None = None
    record: bool = True
    scale: tuple[float, ...] = (1.3, 1.3, 1.0)
    corner: tuple[float, float] = (0.0, 0.0)
    output: Path = Path("sessions")
    feedback: Feedback = Feedback.VISUAL
    hand: Literal["person", "simulated"] = "simulated"
    spin: float | Literal["auto"] = "auto"
    learner: Learner = field(default_factory=lambda: Learner(samples=500))
    examiner: Learner | None = None
    objects: tuple[Surface, ...] = ()


def write(tmp_path, text):
    path = tmp_path / "hm.toml"
    path.write_text(text)
    return path


def refusal(path=None, overrides=None, cls=Options):
    with pytest.raises(ConfigurationError) as caught:
        load(cls, path, overrides)
    return caught.value


def test_without_file_and_overrides_the_defaults_hold():
    assert load(Options) == Options()


def test_a_file_replaces_defaults_and_an_override_replaces_the_file(tmp_path):
    path = write(tmp_path, "seed = 2\npractice_s = 5\n[learner]\nw_gen = 0.6\n")
    merged = merge(Options, path, {"seed": "3"})
    assert (merged.value.seed, merged.value.practice_s, merged.value.learner.w_gen) == (3, 5.0, 0.6)
    assert merged.sources["seed"] == COMMAND_LINE
    assert merged.sources["learner.w_gen"] == str(path)
    assert merged.sources["learner.samples"] == DEFAULT


def test_a_table_keeps_the_values_that_its_default_had(tmp_path):
    assert load(Options, write(tmp_path, "[learner]\nw_gen = 0.6\n")).learner == Learner(
        w_gen=0.6, samples=500
    )


def test_a_whole_number_is_taken_for_a_float_and_becomes_one(tmp_path):
    value = load(Options, write(tmp_path, "practice_s = 30\n")).practice_s
    assert value == 30.0
    assert type(value) is float


def test_arrays_of_tables_become_tuples_of_dataclasses(tmp_path):
    path = write(tmp_path, '[[objects]]\nname = "a"\n[[objects]]\nname = "b"\nstiffness = 300\n')
    assert load(Options, path).objects == (Surface(name="a"), Surface(name="b", stiffness=300.0))


def test_a_relative_path_in_a_file_starts_at_the_file_and_one_on_the_command_line_does_not(tmp_path):
    assert load(Options, write(tmp_path, 'output = "logs"\n')).output == tmp_path / "logs"
    assert load(Options, None, {"output": "logs"}).output == Path("logs")


def test_a_file_with_a_byte_order_mark_and_windows_line_ends_is_read(tmp_path):
    path = tmp_path / "hm.toml"
    path.write_bytes(b"\xef\xbb\xbfseed = 7\r\n")
    assert load(Options, path).seed == 7


@pytest.mark.parametrize(
    ("key", "text", "value"),
    [
        ("practice_s", "1e-3", 0.001),
        ("record", "false", False),
        ("label", "two words", "two words"),
        ("label", "007", "007"),
        ("label", '"quoted"', "quoted"),
        ("feedback", "rendered", Feedback.RENDERED),
        ("feedback", "RENDERED", Feedback.RENDERED),
        ("hand", "person", "person"),
        ("spin", "0.1", 0.1),
        ("spin", "auto", "auto"),
        ("pause_s", "2", 2.0),
        ("pause_s", "none", None),
        ("scale", "[1, 2.5]", (1.0, 2.5)),
        ("corner", "[0.1, 0.2]", (0.1, 0.2)),
    ],
)
def test_an_override_is_read_by_the_type_of_its_field(key, text, value):
    assert getattr(load(Options, None, {key: text}), key) == value


def test_an_override_reaches_into_a_table_that_is_none_by_default():
    assert load(Options, None, {"examiner.w_gen": "0.5"}).examiner == Learner(w_gen=0.5)


@pytest.mark.parametrize(
    ("text", "field_name", "words"),
    [
        ("sed = 3", "sed", "did you mean seed?"),
        ("[learner]\nw_gne = 0.5", "learner.w_gne", "did you mean learner.w_gen?"),
        ("[lerner]\nw_gen = 0.5", "lerner.w_gen", "did you mean learner?"),
        ("qqqq = 1", "qqqq", "known here: seed, label"),
        ('seed = "3"', "seed", 'a whole number, not "3"'),
        ("seed = 3.0", "seed", "a whole number, not 3.0"),
        ("seed = true", "seed", "a whole number, not true"),
        ("practice_s = true", "practice_s", "a finite number, not true"),
        ("practice_s = nan", "practice_s", "a finite number, not nan"),
        ("practice_s = -inf", "practice_s", "a finite number, not -inf"),
        (f"practice_s = 1{'0' * 400}", "practice_s", "a finite number"),
        ("record = 1", "record", "true or false, not 1"),
        ("label = 2026-01-01", "label", "text, not 2026-01-01"),
        ("label = []", "label", "text, not an array"),
        ('output = ""', "output", "a path"),
        ('hand = "persn"', "hand", "did you mean person?"),
        ('feedback = "visul"', "feedback", "one of visual, rendered"),
        ("learner = 3", "learner", "a table (Learner), not 3"),
        ("scale = 3", "scale", "an array of a finite number, not 3"),
        ('scale = [1, "a"]', "scale[1]", 'a finite number, not "a"'),
        ("corner = [1]", "corner", "has 1 elements where 2 are needed"),
        ("[learner]\nw_gen = 1.5", "learner.w_gen", "1.5 is outside 0 to 1"),
        ("[[objects]]\nstiffness = 1", "objects[0].name", "is missing and has no default"),
        ('[[objects]]\nname = "a"\nstiffness = -1', "objects[0].stiffness", "-1 N/m must be above 0"),
        ("pause_s = []", "pause_s", 'a finite number or "none", not an array'),
        ("= 3", "file", "not valid TOML"),
    ],
)
def test_a_wrong_file_is_refused_with_field_reason_and_file_named(tmp_path, text, field_name, words):
    path = write(tmp_path, text)
    error = refusal(path)
    assert error.field == field_name
    assert words in error.problem
    assert error.source == str(path)


@pytest.mark.parametrize(
    ("key", "text", "words"),
    [
        ("learner.w_gne", "0.5", "did you mean learner.w_gen?"),
        ("learner", "3", "as in learner.key=value"),
        ("learner", "{w_gen = 0.5}", "as in learner.key=value"),
        ("learner.w_gen.x", "1", "a table"),
        ("seed.x", "1", "a table"),
        ("learner.w_gen", "2", "2 is outside 0 to 1"),
        ("learner.w_gen", "", 'not ""'),
        ("practice_s", "nan", "finite"),
        ("", "1", "no such key"),
    ],
)
def test_a_wrong_override_is_refused_and_the_command_line_named(key, text, words):
    error = refusal(None, {key: text})
    assert words in str(error)
    assert error.source == COMMAND_LINE


def test_setting_inside_a_value_of_the_file_is_refused(tmp_path):
    assert "seed is not a table" in str(refusal(write(tmp_path, "seed = 3"), {"seed.x": "1"}))


def test_a_default_that_clashes_with_the_file_names_the_file(tmp_path):
    @dataclass(frozen=True, kw_only=True)
    class Band:
        low: float = 0.0
        high: float = 1.0

        def __post_init__(self):
            if self.low >= self.high:
                raise ConfigurationError("high", f"{self.high} must exceed low = {self.low}")

    path = write(tmp_path, "low = 2")
    assert refusal(path, cls=Band).source == str(path)


def test_a_file_that_is_not_there_or_not_text_is_refused(tmp_path):
    assert "cannot be read: No such file" in str(refusal(tmp_path / "missing.toml"))
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    assert "not UTF-8" in str(refusal(binary))


def test_assignments_are_split_at_the_first_equals_sign():
    assert parse_overrides(["a.b=1", " c = x=y ", "a.b=2"]) == {"a.b": "2", "c": "x=y"}
    for wrong in ("novalue", "=3", " =3"):
        with pytest.raises(ConfigurationError, match="key=value"):
            parse_overrides([wrong])


texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=20).filter(lambda text: text != "none")
numbers = st.floats(allow_nan=False, allow_infinity=False)
learners = st.builds(
    Learner,
    w_gen=st.floats(0.0, 1.0, exclude_min=True, exclude_max=True),
    samples=st.integers(-(2**70), 2**70),
)
surfaces = st.builds(Surface, name=texts, stiffness=st.floats(1e-300, 1e300))
options = st.builds(
    Options,
    seed=st.integers(),
    label=texts,
    practice_s=numbers,
    pause_s=st.none() | numbers,
    record=st.booleans(),
    scale=st.lists(numbers).map(tuple),
    corner=st.tuples(numbers, numbers),
    output=st.just(Path("/var/lib/hm")),
    feedback=st.sampled_from(Feedback),
    hand=st.sampled_from(["person", "simulated"]),
    spin=st.just("auto") | numbers,
    learner=learners,
    examiner=st.none() | learners,
    objects=st.lists(surfaces, max_size=3).map(tuple),
)


@pytest.fixture(scope="module")
def scratch(tmp_path_factory):
    return tmp_path_factory.mktemp("config") / "written.toml"


@given(value=options)
def test_what_is_written_as_toml_reads_back_to_the_same_values(scratch, value):
    scratch.write_text(to_toml(value), encoding="utf-8", newline="")
    assert load(Options, scratch) == value


@given(value=numbers)
def test_a_number_given_as_text_is_read_to_the_last_bit(value):
    assert math.copysign(1.0, load(Options, None, {"practice_s": repr(value)}).practice_s) == math.copysign(
        1.0, value
    )
    assert load(Options, None, {"practice_s": repr(value)}).practice_s == value


def test_the_plain_tree_has_only_types_that_toml_has():
    tree = to_dict(Options(objects=(Surface(name="a"),)))
    assert tree["feedback"] == "visual"
    assert tree["output"] == "sessions"
    assert tree["pause_s"] == "none"
    assert tree["objects"] == [{"name": "a", "stiffness": 100.0}]
    assert tree["learner"] == {"w_gen": 0.8, "samples": 500}


def test_a_comment_is_written_behind_its_line_and_leaves_the_file_readable(scratch):
    text = to_toml(Options(), comments={"learner.w_gen": "default", "seed": "hm.toml"})
    assert "seed = 1  # hm.toml" in text
    assert "w_gen = 0.8  # default" in text
    scratch.write_text(text)
    assert load(Options, scratch).learner == Options().learner


def test_the_docstrings_under_the_fields_are_found_by_dotted_key():
    assert documentation(Options())["learner.w_gen"] == "Activation below which a model is made [1]."
