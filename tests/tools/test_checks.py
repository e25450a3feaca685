from pathlib import Path

from tools import checks
from tools.checks import Skipped, missing_from, skipped_tests

JUNIT = """<?xml version="1.0" encoding="utf-8"?>
<testsuites><testsuite name="pytest" tests="3" skipped="1">
<testcase classname="tests.tools.test_page" name="test_the_page_opens">
<skipped type="pytest.skip" message="no browser">tests/tools/test_page.py:3: no browser</skipped></testcase>
<testcase classname="tests.tools.test_page" name="test_the_page_is_written"/>
</testsuite></testsuites>
"""


def test_skipped_tests_are_named_with_their_reason(tmp_path):
    junit = tmp_path / "junit.xml"
    junit.write_text(JUNIT)
    assert skipped_tests(junit) == [Skipped("tests.tools.test_page::test_the_page_opens", "no browser")]


def test_without_a_test_run_nothing_counts_as_skipped(tmp_path):
    assert skipped_tests(tmp_path / "junit.xml") == []


def test_a_file_that_the_wheel_forgot_is_found():
    assert missing_from(["a/__init__.py"], ["a/__init__.py", "a/task.toml"]) == ["a/task.toml"]


def test_outside_a_checkout_it_says_where_to_go(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert checks.main() == 2
    assert "top of a checkout" in capsys.readouterr().out


def test_the_readme_has_one_test_command_for_continuous_integration():
    text = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    block = text.partition("<!-- command: tests -->\n")[2].partition("<!-- end -->")[0]
    commands = [line for line in block.splitlines() if line.startswith("python3 ")]
    assert len(commands) == 1
    assert "-m tools.checks" in commands[0]
