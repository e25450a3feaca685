from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.state_machine import (
    RENDERING,
    REQUESTABLE,
    TRANSITIONS,
    Event,
    StateMachine,
    StateRefused,
    transitions_as_markdown,
    transitions_as_mermaid,
)
from hm_driver.protocol.vocabulary import State


def machine_in(state: State) -> StateMachine:
    machine = StateMachine(position_calibrated=True)
    if state is State.FAULT:
        machine.request(State.STOP)
        machine.happen(Event.GUARD_TRIPPED, "test")
    elif state in (State.OFF, State.INIT, State.STOP):
        machine.request(state)
    else:
        machine.request(State.STOP)
        machine.request(state)
    return machine


def test_the_published_start_sequence_is_allowed():
    machine = StateMachine()
    machine.request(State.INIT)
    assert machine.happen(Event.INIT_FINISHED)
    for state in (
        State.FORCE,
        State.STOP,
        State.HOME,
        State.POSITION,
        State.OFF,
    ):
        if state is not State.OFF:
            machine.request(state)
            assert machine.state is state
    machine.request(State.OFF)


@pytest.mark.parametrize("state", [State.FORCE, State.POSITION, State.HOME])
def test_an_uncalibrated_arm_renders_nothing(state):
    machine = StateMachine()
    machine.request(State.STOP)
    with pytest.raises(StateRefused, match="set state init"):
        machine.request(state)
    assert machine.state is State.STOP


def test_init_goes_to_stop_by_itself_and_calibrates():
    machine = StateMachine()
    machine.request(State.INIT)
    assert not machine.position_calibrated
    with pytest.raises(StateRefused, match="accepted: off, init, stop"):
        machine.request(State.FORCE)
    machine.happen(Event.INIT_FINISHED)
    assert machine.state is State.STOP
    assert machine.position_calibrated


def test_an_aborted_init_leaves_the_arm_uncalibrated():
    machine = machine_in(State.FORCE)
    machine.request(State.INIT)
    machine.request(State.STOP)
    assert not machine.position_calibrated


def test_a_fault_keeps_its_reason_until_it_is_acknowledged():
    machine = machine_in(State.FORCE)
    machine.happen(Event.GUARD_TRIPPED, "speed 1.4 m/s above 1.2 m/s")
    assert machine.state is State.FAULT
    with pytest.raises(StateRefused, match=r"speed 1.4 m/s above 1.2 m/s.*accepted: .*init.*off|off.*init"):
        machine.request(State.FORCE)
    machine.request(State.OFF)
    assert machine.fault_reason == ""


def test_without_drive_power_only_off_is_accepted():
    machine = machine_in(State.FORCE)
    machine.emergency_button_pushed = True
    machine.happen(Event.POWER_CUT)
    assert machine.state is State.OFF
    for state in REQUESTABLE:
        if state is State.OFF:
            machine.request(state)
        else:
            with pytest.raises(StateRefused, match="emergency button"):
                machine.request(state)
    machine.emergency_button_pushed = False
    machine.relay_closed = False
    with pytest.raises(StateRefused, match="relay"):
        machine.request(State.STOP)


def test_a_stop_can_always_be_asked_for_except_in_fault():
    for state in State:
        if state is not State.FAULT:
            machine_in(state).request(State.STOP)


def test_every_pair_of_source_and_trigger_has_one_target():
    triggers = [(row.source, row.trigger) for row in TRANSITIONS]
    assert len(triggers) == len(set(triggers))


def test_only_powered_states_render():
    for rendering in RENDERING.values():
        assert rendering.powered or not (rendering.effects or rendering.force_sensor or rendering.driven)


@given(st.lists(st.sampled_from([*State, *Event]), max_size=30), st.booleans())
def test_the_machine_never_leaves_its_table(triggers, has_button_pushed):
    machine = StateMachine(emergency_button_pushed=has_button_pushed)
    path = [machine.state]
    for trigger in triggers:
        if isinstance(trigger, Event):
            machine.happen(trigger, "reason")
        else:
            try:
                machine.request(trigger)
            except StateRefused:
                continue
        path.append(machine.state)
    allowed = {(row.source, row.target) for row in TRANSITIONS}
    assert all(before is after or (before, after) in allowed for before, after in pairwise(path))
    assert (machine.state is State.FAULT) == bool(machine.fault_reason)
    if has_button_pushed:
        assert not RENDERING[machine.state].powered


def test_the_documentation_draws_the_table_as_it_is():
    page = (Path(__file__).parents[2] / "docs" / "states.md").read_text(encoding="utf-8")
    assert transitions_as_markdown() in page
    assert transitions_as_mermaid() in page
