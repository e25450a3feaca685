import sys
import time

import pytest

from hm_driver.errors import ConfigurationError
from hm_driver.realtime.law import LawRunner, load_law
from hm_driver.realtime.setpoint import LoopState, SetPoint

MS = 1_000_000


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Writes a module of the user, and returns the path of its law."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def write(name, text):
        (tmp_path / f"{name}.py").write_text(text)
        return f"{name}:Law"

    yield write
    for name in [name for name in sys.modules if name.startswith("users_") or name == "pandas"]:
        del sys.modules[name]


def test_a_law_is_loaded_and_run(module):
    path = module(
        "users_good",
        "class Law:\n    def step(self, state, command, dt):\n        return command._replace(bias_x=1.0)\n",
    )
    set_point, problem = load_law(path, period_ns=MS).step(LoopState(), SetPoint(target_z=0.5), 0.001)
    assert problem == ""
    assert SetPoint(*set_point) == SetPoint(sequence=1.0, target_z=0.5, bias_x=1.0)


def test_the_loop_gets_a_law_that_its_dry_run_has_not_touched(module):
    text = (
        "class Law:\n    steps = 0\n    def step(self, state, command, dt):\n"
        "        self.steps += 1\n        return command._replace(bias_x=float(self.steps))\n"
    )
    runner = load_law(module("users_counts", text), period_ns=MS)
    assert [runner.step(LoopState(), SetPoint(), 0.001)[0][11] for _ in range(2)] == [1.0, 2.0]


MANY = "import sys, types\nsys.modules.update({f'users_{k}': types.ModuleType('m') for k in range(210)})"


def law(body, before=""):
    return f"{before}\nclass Law:\n    def step(self, state, command, dt):\n        {body}\n"


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("users_heavy", law("return command", "import pandas"), "imports pandas"),
        ("users_raises", law("return 1 / 0"), "ZeroDivisionError"),
        ("users_nan", law("return command._replace(bias_x=float('nan'))"), "nan"),
        ("users_short", law("return command[:3]"), "not a SetPoint"),
        ("users_none", law("pass"), "TypeError"),
        ("users_slow", law("time.sleep(0.001); return command", "import time"), "took"),
        ("users_many", law("return command", MANY), "brings 2.. modules"),
        ("users_exits", law("return command", "raise SystemExit(3)"), "SystemExit"),
        ("users_empty", "", "AttributeError"),
        ("users_broken", "class Law\n", "SyntaxError"),
    ],
)
def test_a_law_that_would_not_do_is_refused_with_the_reason(module, tmp_path, name, text, reason):
    (tmp_path / "pandas.py").write_text("")  # stands for what the loop refuses, wherever that is installed
    with pytest.raises(ConfigurationError, match=reason):
        load_law(module(name, text), period_ns=MS)


@pytest.mark.parametrize(
    "text", [law("time.sleep(60)", "import time"), "import time\ntime.sleep(60)\n"], ids=["step", "import"]
)
def test_a_law_that_blocks_is_refused(module, text):
    with pytest.raises(ConfigurationError, match="did not return"):
        load_law(module("users_blocks", text), period_ns=MS, patience_s=0.3)


@pytest.mark.parametrize("path", ["", "module", ":Law", "module:"])
def test_a_path_that_is_not_module_and_class_is_refused(path):
    with pytest.raises(ConfigurationError, match="module:Class"):
        load_law(path, period_ns=MS)


def test_a_law_may_be_late_twice_in_a_row_and_not_three_times():
    class Law:
        def step(self, state, command, dt):  # noqa: ARG002  # a law's signature
            time.sleep(0.0015)
            return command

    runner = LawRunner(Law(), name="slow", budget_ns=MS)
    problems = [runner.step(LoopState(), SetPoint(), 0.001)[1] for _ in range(3)]
    assert problems[:2] == ["", ""]
    assert "1000 µs are allowed" in problems[2]


def test_a_law_that_a_stall_of_the_machine_holds_up_once_goes_on_and_one_that_hangs_does_not():
    class Law:
        seconds = 0.008

        def step(self, state, command, dt):  # noqa: ARG002  # a law's signature
            time.sleep(self.seconds)
            return command

    law = Law()
    runner = LawRunner(law, name="stalled", budget_ns=MS // 3)
    assert runner.step(LoopState(), SetPoint(), 0.001)[1] == ""
    law.seconds = 0.035
    assert "333 µs are allowed" in runner.step(LoopState(), SetPoint(), 0.001)[1]
