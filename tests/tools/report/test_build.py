import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from hm_driver.errors import RecordingError
from hm_driver.geometry import ArmGeometry, cartesian_to_joint
from hm_driver.recording.reader import Recording
from hm_driver.recording.schemas import DEVICE_CHANNELS
from hm_driver.recording.writer import LogWriter
from teaching.messages import LEARNER_STATE
from teaching.task_file import load_task
from tools.report import build_report
from tools.report.figures.learning import activation_ellipses
from tools.report.figures.mapping import reach_outline
from tools.report.session_data import WANTED, _skills, load_session
from tools.report.summary import analyse
from tools.report.words import sources
from tools.run.options import ArbitrationKind, LearnerKind

SECTIONS = {"learning", "execution", "run-maps", "run-course", "numbers", "handle", "mapping", "timing"}


class Outline(HTMLParser):
    def __init__(self):
        super().__init__()
        self.sections, self.links = set(), []

    def handle_starttag(self, tag, attrs):
        named = dict(attrs)
        if tag == "section":
            self.sections.add(named["id"])
        self.links += [value for name, value in attrs if name in ("src", "href", "xlink:href")]


def outline_of(path):
    outline = Outline()
    outline.feed(path.read_text(encoding="utf-8"))
    return outline


@pytest.fixture(scope="module")
def report(short_log, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    return path, build_report(short_log, path)


def test_the_report_has_every_figure_and_table(report):
    assert outline_of(report[0]).sections == SECTIONS


def test_the_report_is_one_file_that_loads_nothing(report):
    text = report[0].read_text(encoding="utf-8")
    outline = outline_of(report[0])
    assert all(link.startswith(("#", "data:image/png;base64,")) for link in outline.links)
    assert "<script" not in text
    assert not re.search(r"@import|url\(\s*[\"']?http", text)


def test_figures_share_no_ids_and_refer_to_their_own(report):
    seen = set()
    for figure in re.findall(r"<svg.*?</svg>", report[0].read_text(encoding="utf-8"), flags=re.DOTALL):
        ids = set(re.findall(r'\bid="([^"]+)"', figure))
        used = set(re.findall(r"url\(#([^)]+)\)", figure)) | set(re.findall(r'href="#([^"]+)"', figure))
        assert ids
        assert used <= ids
        assert not ids & seen
        seen |= ids


def test_equal_logs_give_equal_reports(short_log, report, tmp_path):
    build_report(short_log, tmp_path / "again.html")
    assert (tmp_path / "again.html").read_bytes() == report[0].read_bytes()


def test_the_summary_is_what_the_log_says(short_log, report):
    summary, data = report[1], load_session(short_log)
    assert summary.updates == len(data.skills) >= 2
    assert summary.samples == 200 * summary.updates
    assert summary.models == summary.models_added - summary.models_pruned
    assert summary.coverage == pytest.approx(data.skills[-1].coverage, abs=1e-3)
    assert summary.session_s == pytest.approx(data.ticks.time_s[-1])
    assert summary.practice_s == pytest.approx(1.0, abs=0.02)
    assert summary.autonomous_s > 1.0
    assert summary.cycles > 10_000
    assert 0.0 < summary.lateness_us.p50 < summary.lateness_us.p99 < summary.lateness_us.max
    assert summary.run.force.overall.mean > 0.0
    assert summary.run.rendering.overall.mean < summary.run.force.overall.mean


def test_the_summary_becomes_json_without_nan(report):
    text = json.dumps(report[1].as_dict(), allow_nan=False)
    keys = json.loads(text)
    assert set(keys["grid"]["inside"]) == {"mean", "p95", "max"}
    assert set(keys["run"]) == {"force", "skill", "rendering"}
    assert set(keys["lateness_us"]) == {"p50", "p99", "p99_9", "max"}


def test_every_column_that_the_report_reads_is_written(short_log):
    names = {column for wanted in WANTED.values() for column in wanted}
    assert names
    assert set(WANTED["/teaching/learner"]) <= set(LEARNER_STATE.columns)
    data = load_session(short_log)
    assert len(data.ticks.time_s) > 1000
    assert len(data.cycles.time_s) >= 10 * len(data.ticks.time_s)
    assert data.task.to_dict() == load_task("paper").to_dict()


def test_the_report_says_whose_learner_and_arbitration_are(report):
    text = report[0].read_text(encoding="utf-8")
    assert "Learner lwr: the paper&#x27;s. Arbitration paper: the paper&#x27;s eq. (9)." in text


@pytest.mark.parametrize(
    "kind", [kind.value for kind in ArbitrationKind if kind is not ArbitrationKind.PAPER]
)
def test_what_is_not_the_papers_is_called_ours(kind):
    assert f"Arbitration {kind}: ours" in sources("multi", kind)
    assert all(sources(learner.value, kind).count("unknown") == 0 for learner in LearnerKind)


def test_the_report_tells_how_well_the_skills_own_deviation_finds_what_is_wrong(short_log):
    data = load_session(short_log)
    summary = analyse(data).summary
    assert 0.0 <= summary.auc_std <= 1.0
    assert summary.as_dict()["auc_w_max"] is not None


def test_a_log_from_before_variances_were_logged_is_read(short_log):
    with Recording(short_log) as log:
        columns = log.columns("/teaching/learner")
    del columns["variances"]
    skills = _skills(columns, 0)
    assert skills[-1].variances is None
    summary = analyse(replace(load_session(short_log), skills=skills)).summary
    assert summary.as_dict()["auc_std"] is None
    assert summary.auc_w_max == analyse(load_session(short_log)).summary.auc_w_max


def test_a_session_cut_off_before_any_update_is_still_reported(tmp_path, write_session, short_options):
    log = write_session(tmp_path / "cut.mcap", options=short_options, stop_s=2.0, finish=False)
    summary = build_report(log, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert summary.updates == 0
    assert math.isnan(summary.grid.overall.mean)
    assert "The log is not whole" in text
    assert "never updated" in text
    assert "ended before the autonomous run" in text
    assert outline_of(tmp_path / "report.html").sections == SECTIONS - {"learning", "run-maps", "run-course"}


def test_a_task_of_one_object_has_no_borders_and_is_reported(tmp_path, write_session, short_options):
    task = tmp_path / "one.toml"
    task.write_text(
        'name = "one"\n[plane]\n[reference]\n[[objects]]\nname = "all"\ncolour = "green"\nstiffness = 200.0\n'
        "rectangle = [-0.2, -0.2, 0.2, 0.2]\n"
    )
    log = write_session(tmp_path / "one.mcap", options=replace(short_options, task=str(task)), stop_s=6.0)
    summary = build_report(log, tmp_path / "report.html")
    assert summary.updates >= 1
    assert math.isnan(summary.grid.border.mean)
    assert summary.grid.inside == summary.grid.overall


def test_a_log_without_a_session_is_refused_with_what_it_holds(tmp_path):
    with LogWriter(tmp_path / "other.mcap", DEVICE_CHANNELS):
        pass
    with pytest.raises(
        RecordingError, match="no teaching session: no /teaching/arbitration; there are: /device"
    ):
        build_report(tmp_path / "other.mcap", tmp_path / "report.html")
    with pytest.raises(RecordingError, match="cannot be opened"):
        build_report(tmp_path / "nothing.mcap", tmp_path / "report.html")


def test_ellipses_are_where_the_activation_is_w_th():
    D = np.array([[[400.0, 100.0], [100.0, 200.0]]])
    (width,), (height,), (angle,) = activation_ellipses(D, 0.5)
    for length, turn in ((width, angle), (height, angle + 90.0)):
        x = 0.5 * length * np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn))])
        assert np.exp(-0.5 * x @ D[0] @ x) == pytest.approx(0.5)


def test_the_drawn_reach_lies_on_the_end_stops():
    geometry = ArmGeometry()
    for x, y in reach_outline(geometry):
        r, phi, _ = cartesian_to_joint(x, y, 0.0, geometry.r0)
        assert min(abs(r - geometry.r_min), abs(r - geometry.r_max)) < 1e-9
        assert geometry.phi_min - 1e-9 <= phi <= geometry.phi_max + 1e-9
