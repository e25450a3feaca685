from hm_driver.recording.reader import Recording
from tools.bench.log import Cost, make_log, measure_all, table


def test_the_log_has_its_size_and_what_a_loop_logs(tmp_path):
    make_log(tmp_path / "bench.mcap", 300_000)
    with Recording(tmp_path / "bench.mcap") as log:
        assert 300_000 <= log.path.stat().st_size < 900_000
        counts = log.counts
        assert counts["/device/state"] == counts["/loop/timing"] > 500
        force = log.columns("/device/state")["measured_force.z"]
    assert force.std() > 1.0


def test_a_cost_is_that_of_a_process_of_its_own(tmp_path):
    make_log(tmp_path / "bench.mcap", 100_000)
    (cost,) = measure_all(tmp_path / "bench.mcap", commands=["info"])
    assert "/device/state" in cost.output
    assert cost.wall_s > 0.0
    assert 10.0 < cost.memory_mb < 500.0


def test_the_table_says_what_is_wanted():
    costs = [
        Cost(name="one signal", wall_s=2.0, memory_mb=90.0, output="1000 1.6\n"),
        Cost(name="info", wall_s=0.5, memory_mb=40.0, output=""),
    ]
    lines = table(costs, 100_000_000)
    assert lines[2].split() == ["one", "signal", "2.00", "50.0", "90"]
    assert "62.5 MB/s of file, wanted at least 50" in lines[4]
    assert lines[-1] == "largest memory: 90 MB, wanted below 500 MB"
