import re
import tomllib
from pathlib import Path

import pytest

from hm_driver.version import __version__
from tools.cli.failures import ExitCode
from tools.cli.main import application

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_what_a_document_links_to_is_there(document):
    links = re.findall(r"\]\((?!https?:|#)([^)#]+)", document.read_text(encoding="utf-8"))
    missing = [link for link in links if not (document.parent / link).exists()]
    assert missing == []


def test_the_readme_lists_the_exit_codes_that_there_are():
    listed = {int(code) for code in re.findall(r"^\| (\d+) \|", README, flags=re.MULTILINE)}
    assert listed == {int(code) for code in ExitCode}


def test_every_command_that_the_readme_names_exists():
    app = application()
    for first, second in re.findall(r"`hm ([a-z]+)(?: ([a-z]+))?", README):
        names = {name for name in app if not name.startswith("-")}
        assert first in names
        if first in ("config", "log"):
            assert second in set(app[first])


def test_the_citation_names_the_version_and_the_paper():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {__version__}\n" in citation
    text = " ".join(citation.split())
    assert "Online Human-in-the-Loop Robot Learning Based on Locally Weighted Regression" in text


def test_the_version_has_one_source():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert project["project"]["dynamic"] == ["version"]
    assert project["tool"]["hatch"]["version"]["path"] == "hm_driver/version.py"
