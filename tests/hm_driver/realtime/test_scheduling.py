import json
import os
import subprocess
import sys

import pytest

from hm_driver.errors import ConfigurationError, LoopError
from hm_driver.realtime.scheduling import Rung, enter_realtime

PROGRAM = """
import json, os, sys
from hm_driver.errors import LoopError
from hm_driver.realtime.scheduling import enter_realtime, prepare_process, timer_slack_ns
if sys.argv[1] == "nobody":
    os.setgroups([]); os.setgid(65534); os.setuid(65534)
if sys.argv[1] == "rttime":
    import resource, signal
    signal.signal(signal.SIGXCPU, signal.SIG_IGN)
    resource.setrlimit(15, (15_000, resource.RLIM_INFINITY))
try:
    granted = enter_realtime(40, cpu=0, require_realtime=sys.argv[2] == "require")
except LoopError as error:
    print(json.dumps({"error": str(error)}))
    sys.exit()
prepared = prepare_process()
affinity, slack_ns = sorted(os.sched_getaffinity(0)), timer_slack_ns()
print(json.dumps({
    "rung": granted.rung, "priority": granted.priority, "refusals": granted.refusals, "cpu": granted.cpu,
    "may_spin": granted.may_spin, "slack": slack_ns, "policy": os.sched_getscheduler(0),
    "affinity": affinity, "locked": prepared.memory_locked, "text": granted.describe()}))
granted.release()
"""


def run(user: str, requirement: str = "") -> dict:
    command = [sys.executable, "-c", PROGRAM, user, requirement]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=30)  # ours
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def as_myself() -> dict:
    return run("myself")


def test_the_rung_that_is_reported_is_the_one_that_the_kernel_knows(as_myself):
    if as_myself["rung"] == "fifo":
        assert as_myself["policy"] == os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        assert as_myself["priority"] == 40
    else:
        assert as_myself["refusals"]
        assert as_myself["priority"] == 0
    assert as_myself["rung"] in as_myself["text"]
    assert as_myself["affinity"] == [0]


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can become nobody")
def test_without_privilege_the_timer_slack_alone_is_granted_and_the_refusals_are_said():
    granted = run("nobody")
    assert granted["rung"] == "slack"
    assert granted["slack"] == 1
    assert any("SCHED_FIFO" in refusal for refusal in granted["refusals"])
    assert any("nice" in refusal for refusal in granted["refusals"])


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can become nobody")
def test_required_real_time_is_refused_with_what_to_do():
    assert "RLIMIT_RTPRIO" in run("nobody", "require")["error"]


def test_a_short_limit_on_real_time_processor_time_forbids_spinning():
    granted = run("rttime")
    assert granted["may_spin"] is (granted["rung"] != "fifo")


def test_a_lower_rung_can_be_asked_for():
    granted = enter_realtime(best=Rung.PLAIN, hold_dma_latency=False)
    assert (granted.rung, granted.rung.level, granted.priority) == (Rung.PLAIN, 3, 0)
    with pytest.raises(LoopError):
        enter_realtime(best=Rung.PLAIN, require_realtime=True)


def test_a_priority_out_of_range_is_refused():
    with pytest.raises(ConfigurationError, match="1 to 99"):
        enter_realtime(0)
