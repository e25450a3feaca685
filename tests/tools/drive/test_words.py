import io
import json
from dataclasses import replace

import pytest

from hm_driver.device.haptic_master import connect
from hm_driver.errors import ConfigurationError, DeviceError, HapticMasterError
from hm_driver.protocol.vocabulary import State
from tools.drive.console import Console
from tools.drive.language import commands
from tools.drive.log import DriveLog
from tools.drive.options import DriveOptions
from tools.drive.outcome import CommandRefused
from tools.drive.script import run_script
from tools.drive.session import Drive
from tools.drive.surface import Context
from tools.drive.words import build_words, carry_out

PATIENT = {"missed_s": 0.0, "freeze_s": 2.0, "heartbeat_s": 2.0, "exchange_timeout_s": 2.0}


class Said:
    """A context whose words are said by `say`, which returns what they wrote."""

    def __init__(self, context, out):
        self.context = context
        self._out = out

    def __call__(self, line):
        start = len(self._out.getvalue())
        for command in commands(line):
            carry_out(self.context, command)
        return self._out.getvalue()[start:]


@pytest.fixture(scope="module")
def say(emulator):
    """Says words to one drive that all tests of this module share; its loop starts with the first `hold`."""
    defaults = DriveOptions()
    options = replace(defaults, watch=replace(defaults.watch, **PATIENT))
    out = io.StringIO()
    console = Console(out, io.StringIO())
    with (
        DriveLog(emulator.url, options) as log,
        Drive(emulator.url, options, log, tell=console.tell) as drive,
    ):
        context = Context(console=console, words=build_words(options))
        context.opened = drive
        yield Said(context, out)


@pytest.fixture(scope="module")
def robot(emulator):
    """A connection of its own, to see what the device was told."""
    arm = connect(emulator.url)
    yield arm
    arm.close()


def test_axes_are_held_and_released_by_either_name(say):
    assert say("hold") == "x y z held\n"
    assert say("release z") == "x y held, z free\n"
    assert say("mode admittance y; mode position z") == "x held, y z free\nx z held, y free\n"
    assert say("hold --seconds 0.1") == "x y z held\n"


def test_an_effect_is_made_set_listed_switched_and_removed(say, robot):
    assert say("effect list") == "none; 'effect create TYPE NAME' makes one\n"
    assert say("effect create spring guide stiffness=50 pos=[0, 0, 0.01] --enable") == (
        "spring guide created, enabled\n"
    )
    assert robot.is_enabled("guide")
    assert robot.parameter("guide", "pos") == (0.0, 0.0, 0.01)
    assert say("effect set guide stiffness=60 dampfactor=0.5") == "guide: stiffness=60, dampfactor=0.5\n"
    assert robot.parameter("guide", "stiffness") == 60.0
    assert say("effect list") == "guide  spring     enabled   stiffness=60 pos=[0,0,0.01] dampfactor=0.5\n"
    assert say("effect disable guide") == "guide disabled\n"
    assert not robot.is_enabled("guide")
    assert say("create damper brake; effect remove all") == (
        "Effect damper with name brake created\nall removed\n"
    )
    with pytest.raises(DeviceError):
        robot.is_enabled("guide")


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("effect create spring", "usage: effect create TYPE NAME"),
        ("effect create sprng a", "no type 'sprng'"),
        ("effect create spring 1a", "effect create NAME: '1a' is no name"),
        ("effect create spring assist", "'assist' is the loop's own"),
        ("effect create spring a stif=1", "effect spring: has no 'stif'; did you mean stiffness"),
        ("effect create spring a stiffness", "is not of the form PARAMETER=VALUE"),
        ("effect create spring a stiffness=[1,2,3]", "accepted: a number 0 to 100000 N/m"),
        ("effect set nothing stiffness=1", "no effect 'nothing' was made here; there are: none"),
        ("effect enable", "NAME is missing; usage: effect enable NAME"),
        ("effect enable nothing", "no effect 'nothing' was made here"),
        ("effect list all", "effect list: 'all' is too much"),
        ("effect list --enable", "belongs to 'effect create'"),
        ("record stop", "nothing is being recorded"),
        ("record a.mcap --output b.mcap", "the log is named twice"),
    ],
)
def test_a_wrong_line_is_refused_with_what_would_be_right(say, line, told):
    with pytest.raises(ConfigurationError) as caught:
        say(line)
    assert told in str(caught.value)


def test_an_effect_that_would_jump_is_not_left_behind(say, robot):
    with pytest.raises(ConfigurationError, match=r"push: would act on the handle at once with 50\.0 N"):
        say("effect create biasforce push force=[0,0,50] --enable")
    with pytest.raises(DeviceError):
        robot.is_enabled("push")


def test_a_value_that_the_device_refuses_is_explained_and_the_object_removed(say, robot):
    with pytest.raises(CommandRefused) as caught:
        say("effect create spring guide stiffness=-1")
    assert "accepted: a number 0 to 100000 N/m" in caught.value.__notes__[0]
    with pytest.raises(DeviceError):
        robot.is_enabled("guide")


def test_the_state_is_shown_in_lines_and_as_json(say):
    say("hold")
    rows = say("state --once")
    assert "mode      position" in rows
    assert "periods missed" in rows
    lines = say("state --json --seconds 0.35 --rate 10").splitlines()
    assert 3 <= len(lines) <= 5
    assert {json.loads(line)["state"] for line in lines} == {"force"}
    assert "force, position  pos" in say("state --seconds 0")


def test_mass_and_control_are_shown_and_chosen(say, robot):
    assert say("inertia 4") == "inertia 4 kg\n"
    assert robot.inertia == 4.0
    assert say("control bias; control") == "bias\nbias\n"
    assert say("control spring") == "spring\n"
    assert say("inertia") == "inertia 4 kg\n"


def test_limits_and_help_tell_numbers_with_units(say):
    limits = say("limits")
    assert "joint phi      -0.504 to 0.507 rad" in limits
    assert "0.1 m/s unless said, 0.25 m/s at most" in limits
    assert "goto X Y Z [--speed V]" in say("help")
    assert "Move along one axis" in say("help jog")


def test_a_stop_ends_the_loop_and_the_device_stands(say, robot):
    say("hold")
    assert say("stop") == "state stop\n"
    assert robot.state is State.STOP
    assert "loop      none; 'hold' or 'release' starts it" in say("state --once")


def test_a_script_ends_with_quit_and_names_the_line_that_fails(say):
    run_script(say.context, io.StringIO("# nothing\nget os; get state\nquit\nlevitate\n"))
    assert say.context.is_over
    say.context.is_over = False
    with pytest.raises(HapticMasterError) as caught:
        run_script(say.context, io.StringIO("get os\n\njog w 1\nget os\n"))
    assert caught.value.__notes__ == ["line 3: jog w 1; nothing behind it was carried out"]
