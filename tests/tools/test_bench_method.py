import json

import pytest

from tools.bench.method import FIGURES, Group, job_of, measure, read, table
from tools.run.options import load_options


def row(key, border, **changes):
    return {"key": key} | {name: 1.0 for name, _ in FIGURES} | {"grid_border_mean": border} | changes


def test_a_session_is_that_of_the_method_and_another_seed_or_value_is_another():
    one = job_of("paper", "confident", 3)
    assert one.options == load_options(None, {"method": "confident", "task": "paper"}).value
    keys = {
        one.key,
        job_of("paper", "confident", 4).key,
        job_of("steep", "confident", 3).key,
        job_of("paper", "confident", 3, ["arbitration.doubt=0.3"]).key,
    }
    assert len(keys) == 4
    assert job_of("paper", "confident", 3).key == one.key


def test_what_is_in_the_store_is_not_run_again_and_a_cut_off_line_is_left_out(tmp_path):
    store = tmp_path / "rows.jsonl"
    job = job_of("paper", "paper", 100)
    store.write_text(json.dumps(row(job.key, 3.5)) + "\n" + '{"key": "half a li')
    assert [one["key"] for one in read(store)] == [job.key]
    (group,) = measure([("paper", "paper", job)], store)
    assert group.mean("grid_border_mean").mean == 3.5
    assert store.read_text().endswith("\n")


def test_the_table_has_means_with_intervals_and_how_far_ours_is_below():
    groups = [
        Group("paper", "paper", [row("a", 3.0), row("b", 4.0), row("c", 5.0)]),
        Group("paper", "confident", [row("d", 1.0), row("e", 1.0, auc_std=None), row("f", 1.0)]),
    ]
    lines = table(groups)
    (border,) = [line for line in lines if "grid border" in line]
    assert border == "| grid border [N] | 4.000 ± 2.484 | 1.000 ± 0.000 |"
    assert "border 75 %" in lines[-1]
    assert "overall 0 % (0 to 0)" in lines[-1]


def test_a_single_method_has_nothing_to_be_compared_with():
    lines = table([Group("paper", "confident", [row("d", 1.0), row("e", 1.0)])])
    assert not [line for line in lines if "below" in line]


def test_no_store_is_an_empty_one(tmp_path):
    assert read(tmp_path / "none.jsonl") == []
    assert measure([], tmp_path / "none.jsonl") == []


@pytest.mark.parametrize("method", ["paper", "confident"])
def test_the_methods_that_are_compared_exist(method):
    assert job_of("paper", method, 0).options.method.value == method
