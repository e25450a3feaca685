from dataclasses import fields

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hm_driver.device import effects
from hm_driver.errors import ConfigurationError, ProtocolError
from hm_driver.protocol.commands import Create, SetParameter, parse_command
from hm_driver.protocol.vocabulary import OBJECT_TYPES

CLASSES = (
    effects.Spring,
    effects.Damper,
    effects.BiasForce,
    effects.Shaker,
    effects.Block,
    effects.Sphere,
    effects.FlatPlane,
    effects.Cylinder,
    effects.Torus,
)


def parameter_names(kind):
    for field in fields(kind):
        if field.name == "surface":
            yield from parameter_names(effects.Surface)
        else:
            yield field.name


def test_there_is_a_class_for_every_type():
    assert {kind.type_name for kind in CLASSES} == set(OBJECT_TYPES)


@pytest.mark.parametrize("kind", CLASSES)
def test_fields_are_the_parameters_of_the_vocabulary(kind):
    assert set(parameter_names(kind)) == set(OBJECT_TYPES[kind.type_name].parameters)


@pytest.mark.parametrize("kind", CLASSES)
def test_an_effect_without_values_is_only_created(kind):
    assert kind().commands("x") == [f"create {kind.type_name} x"]


def test_a_shape_sets_its_own_values_and_its_surfaces():
    plane = effects.FlatPlane(
        pos=(0.0, 0.0, -0.1), normal=(0.0, 0.0, 1.0), surface=effects.Surface(stiffness=20e3, no_pull=True)
    )
    assert plane.commands("floor") == [
        "create flatplane floor",
        "set floor pos [0,0,-0.1]",
        "set floor normal [0,0,1]",
        "set floor stiffness 20000",
        "set floor no_pull true",
    ]


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.floats(0.0, 1e5), st.booleans())
def test_every_command_of_an_effect_is_one_that_the_device_can_read(pos, stiffness, dampglobal):
    spring = effects.Spring(pos=pos, stiffness=stiffness, dampglobal=dampglobal)
    create, *sets = map(parse_command, spring.commands("s"))
    assert create == Create("spring", "s")
    assert [(c.object, c.name) for c in sets] == [("s", name) for name, _ in spring.settings()]
    assert all(isinstance(c, SetParameter) for c in sets)


@pytest.mark.parametrize(
    "values",
    [
        {"stiffness": float("nan")},
        {"stiffness": "soft"},
        {"stiffness": True},
        {"pos": (0.0, 0.0)},
        {"pos": 3.0},
        {"pos": (0.0, 0.0, float("inf"))},
        {"att": (0.0, 0.0, 0.0, 0.0)},
        {"dampglobal": 1.0},
    ],
)
def test_a_value_of_the_wrong_form_is_refused_with_its_field(values):
    with pytest.raises(ConfigurationError) as caught:
        effects.Spring(**values)
    assert caught.value.field == f"spring.{next(iter(values))}"


def test_ranges_are_left_to_the_device():
    assert effects.Spring(stiffness=1e9).commands("s")[1] == "set s stiffness 1e+09"


def test_a_name_that_would_smuggle_in_a_command_is_refused():
    with pytest.raises(ProtocolError):
        effects.Spring().commands("a; set state force")
