"""The safety matrix, each event once: an arm that goes on when its client vanishes is stopped in time."""

import pytest

from tools.bench.safety import EVENTS, run_event
from tools.bench.safety_rig import Rig


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    with Rig(tmp_path_factory.mktemp("safety")) as rig:
        yield rig


@pytest.mark.parametrize("name", EVENTS)
def test_the_arm_is_stopped_in_time_once_and_the_reason_is_told(rig, name):
    event = EVENTS[name]
    stop = run_event(rig, event)
    assert stop.reason in event.reasons, stop.detail
    assert stop.stops == (0 if name == "emergency button" else 1)  # without power it refuses
    assert stop.excess_s <= event.allowed_s, stop
