import os
import subprocess
import sys

import pytest

from hm_driver.errors import LoopError
from hm_driver.realtime.claim import DeviceClaim, remove_stale_claims
from hm_driver.realtime.shared import shared_directory


def test_a_device_is_claimed_once_and_free_again_afterwards():
    with DeviceClaim("tcp://claim-test:1"):
        with pytest.raises(LoopError, match=str(os.getpid())), DeviceClaim("tcp://claim-test:1?dialect=text"):
            pass
        with DeviceClaim("tcp://claim-test:2"):
            pass
    with DeviceClaim("tcp://claim-test:1"):
        pass


def test_the_claim_of_a_killed_loop_is_void_and_its_file_is_removed():
    code = (
        "import os; from hm_driver.realtime.claim import DeviceClaim;"
        "DeviceClaim('tcp://claim-test:3').__enter__(); os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code], check=False)  # our own program
    left = [path for path in shared_directory().iterdir() if "claim_test_3" in path.name]
    assert len(left) == 1
    remove_stale_claims()
    assert not left[0].exists()
