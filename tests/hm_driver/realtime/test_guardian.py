import subprocess
import sys
import time

from hm_driver.realtime.child import spawn
from hm_driver.realtime.guardian import GuardianOptions
from hm_driver.realtime.segment import SEGMENT_SIZE, GuardianStatus, Segment, Word
from hm_driver.realtime.shared import SharedBlock


def test_a_guardian_ends_when_a_loop_dies_that_has_not_touched_the_device(device):
    loop = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    with SharedBlock.create(SEGMENT_SIZE, tag="segment") as block:
        segment = Segment(block.buffer)
        segment.words[Word.LOOP_PID] = loop.pid
        options = GuardianOptions(url=device.url, segment=str(block.path))
        guardian = spawn("hm_driver.realtime.guardian", "main", options)
        deadline = time.monotonic() + 20.0
        while segment.words[Word.GUARDIAN] != GuardianStatus.WATCHING:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        loop.kill()
        loop.wait()
        try:
            assert guardian.wait(20.0) == 0
            assert segment.words[Word.GUARDIAN] == GuardianStatus.ENDED
            assert device.times_of("set state stop") == []
        finally:
            guardian.kill()
            guardian.stdin.close()
            segment.close()
