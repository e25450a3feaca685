import pytest

from hm_driver.errors import ConfigurationError
from hm_driver.protocol.commands import parse_command
from tools.drive.completion import candidates, hint
from tools.drive.effects import EffectTable
from tools.drive.language import commands, find, read
from tools.drive.options import DriveOptions
from tools.drive.words import build_words

WORDS = build_words(DriveOptions())


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("", []),
        ("  # a comment", []),
        ("hold; jog x 0.1 # up", [["hold"], ["jog", "x", "0.1"]]),
        (";;hold;", [["hold"]]),
        ("set s1 pos [0, 0, 0.1]", [["set", "s1", "pos", "[0, 0, 0.1]"]]),
        ("run 'my path.csv'", [["run", "'my path.csv'"]]),
        ("get measpos; get state", [["get", "measpos"], ["get", "state"]]),
    ],
)
def test_a_line_is_split_into_commands(line, expected):
    assert commands(line) == expected


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("gotoo 1 2 3", "gotoo: unknown word; did you mean goto? 'help' lists all"),
        ("xyzzy", "xyzzy: unknown word; 'help' lists all"),
        ("goto 0 0", "goto: Z is missing; usage: goto X Y Z [--speed V]"),
        ("goto 0 0 0 0", "goto: '0' is too much; usage:"),
        ("goto 0 zero 0", "goto Y: 'zero' is no number; accepted: -0.309 to 0.311 m"),
        ("goto nan 0 0", "goto X: 'nan' is no number"),
        ("jog q 0.1", "jog AXIS: 'q' is none of x y z"),
        ("jog x 5", "jog DISTANCE: 5 m is out of range: -1 to 1 m"),
        ("jog x 0.1 --speed 9", "jog --speed: 9 m/s is out of range: 0.001 to 0.25 m/s"),
        ("jog x 0.1 --speed", "jog --speed: needs a value: 0.001 to 0.25 m/s"),
        ("jog x 0.1 --sped 1", "jog: unknown option --sped; did you mean --speed; accepted: --speed"),
        ("state --once=1", "state --once: takes no value"),
        (
            "state forc",
            "state STATE: 'forc' is none of stop force position init home off: did you mean force",
        ),
        ("inertia 1", "inertia MASS: 1 kg is out of range: 2 to 20 kg"),
        ("hold x w", "hold AXIS: 'w' is none of x y z"),
        ("mode force", "mode MODE: 'force' is none of admittance position"),
        ("raw", "raw: COMMAND is missing; usage: raw COMMAND ..."),
        ("wait 1_0", "wait S: '1_0' is no number"),
    ],
)
def test_what_cannot_be_read_is_refused_with_word_value_and_what_is_accepted(line, told):
    (words,) = commands(line)
    with pytest.raises(ConfigurationError) as caught:
        read(find(WORDS, words[0]), words[1:])
    assert told in str(caught.value)


def test_arguments_and_options_are_read_wherever_they_stand():
    call = read(WORDS["goto"], ["--speed", "0.05", "0.1", "-0.02", "-.5e-2"])
    assert [call.number(name) for name in ("X", "Y", "Z", "--speed")] == [0.1, -0.02, -0.005, 0.05]
    assert read(WORDS["goto"], ["0", "0", "0", "--speed=0.05"]).number("--speed") == 0.05
    assert read(WORDS["hold"], ["x", "z"]).rest == ("x", "z")
    assert read(WORDS["run"], ['"my path.csv"']).text("FILE") == "my path.csv"


@pytest.mark.parametrize("word", WORDS.values(), ids=lambda word: word.name)
def test_the_help_of_every_word_names_each_argument_and_option(word):
    text = word.help()
    assert text.startswith(word.name)
    assert all(argument.name in text for argument in word.arguments)
    assert all(option.name in text for option in word.options)


def test_help_tells_unit_and_range():
    assert "(0.001 to 0.25 m/s)" in WORDS["jog"].help()
    assert "(2 to 20 kg)" in WORDS["inertia"].help()


@pytest.fixture
def table():
    """Objects that a prompt has made."""
    table = EffectTable()
    for text in ("create spring guide", "create block wall"):
        table.apply(parse_command(text))
    return table


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("go", {"goto"}),
        ("re", {"release", "record", "remove"}),
        ("jog ", {"x", "y", "z", "--speed"}),
        ("jog x 0.1 --", {"--speed"}),
        ("mode ", {"admittance", "position", "--seconds"}),
        ("mode position ", {"x", "y", "z", "--seconds"}),
        ("state po", {"position"}),
        ("help jo", {"jog"}),
        ("effect cr", {"create"}),
        ("effect create fl", {"flatplane"}),
        ("effect create spring s2 stif", {"stiffness="}),
        ("effect enable ", {"guide", "wall"}),
        ("effect set guide damp", {"dampfactor=", "dampglobal="}),
        ("effect remove ", {"guide", "wall", "all"}),
        ("get measpos", {"measpos", "measposjoint"}),
        ("get gu", {"guide"}),
        ("get guide en", {"enabled"}),
        ("set wall no_", {"no_pull"}),
        ("set guide e", {"enable"}),
        ("set state po", {"position"}),
        ("set in", {"inertia"}),
        ("create tor", {"torus"}),
        ("remove a", {"all"}),
        ("raw get measf", {"measforce", "measforcejoint"}),
        ("raw re", {"remove"}),
        ("hold; jo", {"jog"}),
        ("xyzzy ", set()),
    ],
)
def test_a_line_is_completed_by_what_may_come_next(table, line, expected):
    assert {candidate.text for candidate in candidates(line, WORDS, table)} == expected


def test_paths_are_completed(tmp_path, monkeypatch, table):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "circle.csv").touch()
    (tmp_path / "notes.txt").touch()
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "line.csv").touch()
    assert {c.text for c in candidates("run ", WORDS, table)} >= {"circle.csv", "more/"}
    assert {c.text for c in candidates("run more/", WORDS, table)} == {"more/line.csv"}
    assert not candidates("run nowhere/", WORDS, table)


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("goto 0.1 ", "Y: y of the point, -0.309 to 0.311 m"),
        ("inertia ", "2 to 20 kg"),
        ("stop", "End the loop gently"),
        ("get ", "get QUANTITY | get NAME PARAMETER"),
        ("hold; jog x ", "DISTANCE: how far, -1 to 1 m"),
    ],
)
def test_the_hint_tells_what_the_next_argument_is(line, told):
    assert told in hint(line, WORDS)


def test_an_unknown_word_has_no_hint():
    assert hint("xyzzy 1", WORDS) == ""
