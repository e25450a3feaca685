"""docs/logs.md says what there is: every column, and every command with an example."""

import re
from pathlib import Path

import pytest

from tools.cli.main import application
from tools.log.reference import FOR_VIEWERS, OWN, tables

TEXT = (Path(__file__).parents[3] / "docs" / "logs.md").read_text(encoding="utf-8")
MARK = "python -m tools.log.reference -->\n\n"


def test_the_tables_are_those_of_the_schemas():
    assert TEXT[TEXT.index(MARK) + len(MARK) :] == tables()


def test_every_column_of_every_topic_is_in_the_tables():
    for channel in OWN:
        for column in channel.message.columns:
            assert f"`{column.split('.')[0]}" in TEXT
    for channel in FOR_VIEWERS:
        assert f"| `{channel.topic}` |" in TEXT


@pytest.mark.parametrize("name", [name for name in application()["log"] if not name.startswith("-")])
def test_every_command_has_an_example_and_every_option_in_it_exists(name, capsys):
    examples = re.findall(rf"^hm log {name} (.*)$", TEXT, flags=re.MULTILINE)
    assert examples
    app = application(["log", name])
    app(["log", name, "--help"], exit_on_error=False)
    told = capsys.readouterr().out
    for option in {word for line in examples for word in line.split() if word.startswith("--")}:
        assert option in told


def test_the_viewers_are_said_not_to_have_been_run():
    assert "None of these viewers was run here" in TEXT
