from dataclasses import replace

import pytest

from emulator.process import Emulator
from hm_driver.device.haptic_master import connect
from tools.drive.log import DriveLog
from tools.drive.options import DriveOptions
from tools.drive.session import Drive

PATIENT = {"missed_s": 0.0, "freeze_s": 2.0, "heartbeat_s": 2.0, "exchange_timeout_s": 2.0}


@pytest.fixture(scope="session")
def emulator():
    """An emulator that the tests of this directory share, in the state that the last one left."""
    with Emulator(init_seconds=0.3) as emulator:
        yield emulator


@pytest.fixture
def observer(emulator):
    """A connection beside those of the drive, to see what the device does."""
    arm = connect(emulator.url)
    yield arm
    arm.close()


@pytest.fixture
def options():
    """The configuration, patient with a shared machine."""
    defaults = DriveOptions()
    return replace(defaults, watch=replace(defaults.watch, **PATIENT))


@pytest.fixture
def drive(emulator, options, told):
    """A drive of that emulator."""
    with DriveLog(emulator.url, options) as log, Drive(emulator.url, options, log, tell=told.append) as drive:
        yield drive


@pytest.fixture
def told():
    """What the drive told meanwhile."""
    return []
