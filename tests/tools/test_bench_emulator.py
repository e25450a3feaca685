import pytest

from tools.bench.emulator import OBJECTS, measure_shares, measure_speeds


def test_the_sets_of_objects_are_as_large_as_they_say():
    assert [len(commands) for commands in OBJECTS.values()] == [0, 4, 5, 20]


@pytest.mark.parametrize("name", ["none", "20 of all types"])
def test_the_arm_is_measured_compiled_and_plain(name):
    speeds = measure_speeds(OBJECTS[name], rounds=1, device_s=0.08)
    assert speeds.steps > speeds.plain > 0.0
    assert (speeds.cycles > 0.0) is (name != "none")


def test_the_server_is_measured_beside_a_canary():
    shares = measure_shares(OBJECTS["20 of all types"], seconds=2)
    assert 0.0 < shares.idle < 100.0
    assert shares.asked > 0.0
    assert 0 <= shares.missed < shares.periods
    assert shares.canary >= 0
