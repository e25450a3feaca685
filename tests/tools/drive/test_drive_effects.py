import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hm_driver.errors import ConfigurationError, DeviceError
from hm_driver.protocol.commands import Enable, RemoveAll, SetParameter, parse_command
from tools.drive.effects import EffectTable, pull
from tools.drive.raw import Explainer, doubts, is_question, why_forbidden

HALF = math.sqrt(0.5)


def made(*lines):
    """A table behind these commands."""
    table = EffectTable()
    for line in lines:
        table.apply(parse_command(line))
    return table


@pytest.mark.parametrize(
    ("lines", "handle", "force"),
    [
        (["create spring a", "set a stiffness 100"], (0.1, 0, 0), 10.0),
        (["create spring a", "set a stiffness 100", "set a deadband 0.04"], (0.1, 0, 0), 6.0),
        (["create spring a", "set a stiffness 1e4", "set a maxforce 20"], (0.1, 0, 0), 20.0),
        (["create spring a", "set a stiffness 100", "set a direction [0,0,1]"], (0.1, 0, 0.02), 2.0),
        (["create spring a", "set a stiffness 100", "set a pos [0.1,0,0]"], (0.1, 0, 0), 0.0),
        (["create biasforce a", "set a force [3,0,4]"], (0, 0, 0), 5.0),
        (["create damper a", "set a dampcoef [9,9,9]"], (0, 0, 0), 0.0),
        (["create sphere a", "set a radius 0.05"], (0.03, 0, 0), 200.0),
        (["create sphere a", "set a radius 0.05"], (0.06, 0, 0), 0.0),
        (["create flatplane a", "set a pos [0,0,0.1]"], (0, 0, 0.095), 50.0),
        (["create flatplane a", "set a pos [0,0,0.1]"], (0, 0, 0.2), 0.0),
        (["create block a", "set a size [0.2,0.2,0.02]"], (0.05, 0, 0.008), 20.0),
        (
            ["create block a", "set a size [0.2,0.2,0.02]", f"set a att [{HALF},0,0,{HALF}]"],
            (0.05, 0.008, 0),
            20.0,
        ),
        (["create cylinder a", "set a radius 0.05", "set a length 0.02"], (0.02, 0, 0.008), 20.0),
        (["create torus a", "set a ringradius 0.1", "set a tuberadius 0.02"], (0.118, 0, 0), 20.0),
        (["create torus a", "set a ringradius 0.1", "set a tuberadius 0.02"], (0, 0, 0), 0.0),
    ],
)
def test_the_pull_of_each_type_follows_from_its_parameters(lines, handle, force):
    assert pull(made(*lines).objects["a"], handle) == pytest.approx(force)


@given(st.tuples(*[st.floats(-0.15, 0.15)] * 3), st.floats(-math.pi, math.pi))
def test_a_shape_that_turns_about_its_own_axis_pulls_the_same(handle, angle):
    lines = ["create cylinder a", "set a radius 0.1", "set a length 0.1"]
    turned = made(*lines)
    attitude = (0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2))
    turned.apply(SetParameter("a", "att", attitude))
    assert pull(turned.objects["a"], handle) == pytest.approx(
        pull(made(*lines).objects["a"], handle), abs=1e-6
    )


def test_what_would_pull_too_hard_at_once_is_refused_when_enabled_and_when_changed():
    table = made("create spring guide", "set guide stiffness 1000")
    with pytest.raises(ConfigurationError, match=r"guide: would act on the handle at once with 100\.0 N"):
        table.check_step(Enable("guide"), (0.1, 0, 0), 30.0)
    table.check_step(Enable("guide"), (0.02, 0, 0), 30.0)
    table.apply(Enable("guide"))
    with pytest.raises(ConfigurationError, match="move its pos to the handle"):
        table.check_step(SetParameter("guide", "pos", (0.0, 0.1, 0.0)), (0.02, 0, 0), 30.0)
    table.check_step(SetParameter("guide", "pos", (0.0, 0.01, 0.0)), (0.02, 0, 0), 30.0)


def test_a_disabled_effect_may_be_set_to_anything():
    table = made("create biasforce push")
    table.check_step(SetParameter("push", "force", (100.0, 0.0, 0.0)), (0, 0, 0), 30.0)


def test_the_commands_of_a_table_make_the_same_table_again():
    lines = [
        "create spring guide",
        "set guide stiffness 200",
        "set guide pos [0,0,0.1]",
        "set guide enable",
        "create sphere ball",
        "set ball radius 0.02",
    ]
    table = made(*lines)
    assert [command.encode() for command in table.commands()] == lines
    table.apply(RemoveAll())
    assert not table.commands()


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("get measpos", ""),
        ("get nonsense", ""),
        ("set coulombfriction 1", ""),
        ("create spring s1", ""),
        ("set s1 stiffness 100", ""),
        ("remove s1", ""),
        ("set state stop", "use 'state stop'"),
        ("set inertia 4", "use 'inertia 4'"),
        ("remove all", "use 'effect remove all'"),
        ("remove spring_x", "'spring_x' is the loop's own"),
        ("set feedback force [0,0,9]", "'feedback' is the loop's own"),
        ("set assist enable", "'assist' is the loop's own"),
        ("create spring spring_z", "'spring_z' is the loop's own"),
        ("calibrateforcesensor", "the arm would start to move"),
        ("set velocityguard 9", "not in the vocabulary"),
        ("home", "not in the vocabulary"),
    ],
)
def test_while_the_loop_drives_only_what_cannot_undermine_it_is_allowed(line, told):
    reason = why_forbidden(line)
    assert told in reason if told else reason == ""


def test_questions_are_told_from_commands():
    assert is_question("get  state")
    assert not is_question("getstate")
    assert not is_question("set state stop")


@pytest.mark.parametrize(
    ("line", "answers", "told"),
    [
        ("get measpoz", {}, "'measpoz' is no quantity: did you mean measpos; accepted: state"),
        ("gett state", {}, "'gett' is no verb: did you mean get; accepted: get set create"),
        ("create sprin s2", {}, "'sprin' is no type: did you mean spring; accepted: spring damper"),
        ("set state forse", {}, "'forse' is no state: did you mean force; accepted: off init stop"),
        ("set inertai 4", {}, "'inertai' is nothing that can be set: did you mean inertia"),
        ("set inertia heavy", {}, "'heavy' is no value"),
        ("set inertia 1", {}, "out of range; accepted: a number 2 to 100 kg"),
        ("set s1 stifness 4", {}, "a spring has no 'stifness': did you mean stiffness; accepted: stiffness"),
        ("set s1 stiffness -4", {}, "accepted: a number 0 to 100000 N/m (stiffness)"),
        ("set s1 pos 3", {}, "pos 3.0 has not 3 components; accepted: a vector [x,y,z] -2 to 2 m"),
        ("get s1 colour", {}, "a spring has no 'colour'"),
        ("set s2 enable", {}, "no object 's2' was made here: did you mean s1; there are: s1"),
        ("remove nothing", {}, "no object 'nothing' was made here; there are: s1"),
        ("create spring s1", {}, "there is a spring of that name; remove it first"),
        ("create spring s7", {}, "that another program made ('remove s7')"),
        ("set state force", {"get position_calibrated": "false"}, "'state init' (the arm moves)"),
        ("set state force", {"get emergencybuttonpushed": "true"}, "the emergency button is pushed"),
        ("set state stop", {"get state": "fault"}, "the device is in fault"),
        ("set state force", {}, "another state does not allow it now"),
        ("set s1 stiffness 4", {}, "this firmware differs"),
        ("create", {}, "accepted: create TYPE NAME"),
    ],
)
def test_a_refusal_is_explained_with_what_would_be_accepted(line, answers, told):
    explainer = Explainer(made("create spring s1"), lambda question: answers.get(question, ""))
    assert told in explainer.explain(line)


def test_a_device_that_refuses_questions_too_is_explained_without_them():
    def refuse(question):
        raise DeviceError(question, "--- ERROR")

    assert "another state" in Explainer(EffectTable(), refuse).explain("set state force")


def test_what_a_device_accepted_although_no_one_knows_it_is_doubted():
    table = made("create spring s1")
    assert "no 'stifness' of a spring: did you mean stiffness" in doubts("set s1 stifness 3", table)
    assert "does not know this command" in doubts("set velocityguard 3", table)
    assert doubts("set s1 stiffness 3", table) == ""
    assert doubts("get s1 enabled", table) == ""
