from tools.bench.study import measure_scaling, measure_speeds

SHORT = {"session.give_up": "2", "session.practice": "0.2", "session.autonomous_spacing": "0.4"}


def test_a_fused_session_is_measured_beside_the_fast_one():
    speeds = measure_speeds("paper", rounds=1, overrides=SHORT)
    assert speeds.session_s > 3.0
    assert 0.0 < speeds.fused_s < speeds.fast_s
    assert 0.0 < speeds.tick_us < 1e4 * speeds.fused_s


def test_workers_are_compared():
    scaling = measure_scaling([], (1,), sessions=0, rounds=1)
    assert scaling.sessions == 0
