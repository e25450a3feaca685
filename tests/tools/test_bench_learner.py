import json

import pytest

from tools.bench import learner
from tools.bench.learner import CALLS, BatchRow, CallRow, measure_batches, measure_call, measure_many, tables
from tools.bench.learner_cross import LEARNERS, SIZES, CrossRow, measure_cross


@pytest.mark.parametrize("name", CALLS)
def test_a_call_costs_a_small_share_of_what_plain_numpy_takes(name):
    row = measure_call(name, rounds=6, calls=50)
    assert row.ours_us > 0.0
    assert row.ratio < 2.0 * row.goal


def test_batches_and_many_inputs_are_measured():
    for row in measure_batches(rounds=1, n=5000):
        assert row.points_per_s > 0.0
    assert [row.learner for row in measure_many(5, n=500)] == ["LWPR", "RFWR, diagonal D", "LWR"]


@pytest.mark.parametrize(
    ("name", "most", "models"),
    [
        ("LWR, D = 400", 0.0027, 400),
        ("RFWR", 0.0085, 100),
        ("RFWR, wide overlap", 0.006, 100),
        ("LWPR, full D", 0.014, 100),
    ],
)
def test_a_learner_reaches_the_cross_benchmark_in_one_pass(name, most, models):
    row = measure_cross(name, sizes=(1000, 20_000), seeds=(0,))
    assert row.errors[1] < most < row.errors[0]
    assert row.models <= models


def test_the_tables_say_what_is_met(monkeypatch, capsys):
    calls, batches = [CallRow("predict", 20.0, 2.0, 0.1, 0.15)], [BatchRow("update", 87, 1e5, 3e5)]
    cross = CrossRow("RFWR", (0.1,) * len(SIZES), 87.0, 1e5)
    lines = "\n".join(tables(calls, batches, [], [cross]))
    assert "0.1000 | 0.15 | met" in lines
    assert "100,000 | 300,000 | MISSED" in lines
    monkeypatch.setattr(learner, "measure_call", lambda *_, **__: calls[0])
    monkeypatch.setattr(learner, "measure_batches", lambda: batches)
    monkeypatch.setattr(learner, "measure_many", lambda _: [])
    monkeypatch.setattr(learner, "measure_cross", lambda _: cross)
    learner.main(json=True)
    said = json.loads(capsys.readouterr().out)
    assert said["calls"][0]["ratio"] == 0.1
    assert len(said["cross"]) == len(LEARNERS)
