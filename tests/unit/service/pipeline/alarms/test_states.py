"""The tables of alarm states: complete, without a dead end, and never against who acknowledged."""

import pytest

from service.pipeline.alarms.states import COVERS, PROCESS, AlarmEvent, CoverEvent, diagram, next_cover, next_process
from service.records.operations.alarm import Cover, Process

STATES = list(Process)


def test_every_state_answers_every_event():
    assert set(PROCESS) == set(Process)
    assert all(set(row) == set(AlarmEvent) for row in PROCESS.values())
    assert set(COVERS) == set(Cover)
    assert all(set(row) == set(CoverEvent) for row in COVERS.values())


@pytest.mark.parametrize("is_latching", [False, True])
@pytest.mark.parametrize("state", STATES)
def test_clearing_leads_out_of_every_state(state, is_latching):
    assert next_process(state, AlarmEvent.CLEAR, is_latching=is_latching) is Process.NORMAL
    assert all(next_cover(cover, CoverEvent.CLEAR) is Cover.NONE for cover in Cover)


def test_an_alarm_that_was_seen_and_is_gone_is_closed_in_either_order():
    for order in ((AlarmEvent.ACKNOWLEDGE, AlarmEvent.RETURN), (AlarmEvent.RETURN, AlarmEvent.ACKNOWLEDGE)):
        state = next_process(Process.NORMAL, AlarmEvent.RAISE, is_latching=False)
        for event in order:
            assert state is not Process.NORMAL
            state = next_process(state, event, is_latching=False)
        assert state is Process.NORMAL


def test_what_latches_waits_for_its_clearing():
    for order in (
        (AlarmEvent.ACKNOWLEDGE, AlarmEvent.RETURN),
        (AlarmEvent.RETURN, AlarmEvent.ACKNOWLEDGE),
        (AlarmEvent.RETURN_UNSEEN,),
    ):
        state = Process.UNACKNOWLEDGED
        for event in order:
            state = next_process(state, event, is_latching=True)
        assert state is Process.LATCHED
    assert next_process(Process.NORMAL, AlarmEvent.RETURN, is_latching=True) is Process.NORMAL


def test_only_a_worse_condition_takes_an_acknowledgement_away():
    losing = {event for event in AlarmEvent if PROCESS[Process.ACKNOWLEDGED][event] is Process.UNACKNOWLEDGED}
    assert losing == {AlarmEvent.ESCALATE}


def test_what_nobody_was_told_of_needs_no_acknowledgement():
    assert PROCESS[Process.UNACKNOWLEDGED][AlarmEvent.RETURN] is Process.RETURNED
    assert PROCESS[Process.UNACKNOWLEDGED][AlarmEvent.RETURN_UNSEEN] is Process.NORMAL


def test_shelving_stands_above_suppression():
    assert next_cover(Cover.SUPPRESSED, CoverEvent.SHELVE) is Cover.SHELVED
    assert next_cover(Cover.SHELVED, CoverEvent.SUPPRESS) is Cover.SHELVED
    assert next_cover(Cover.SHELVED, CoverEvent.RELEASE) is Cover.SHELVED
    assert next_cover(Cover.SUPPRESSED, CoverEvent.UNSHELVE) is Cover.SUPPRESSED


def test_the_diagram_draws_every_change_of_state_once():
    drawn = diagram()
    for state, row in PROCESS.items():
        for target in set(row.values()) - {state}:
            names = ", ".join(event.name for event in AlarmEvent if row[event] is target)
            assert drawn.count(f"    {state.value} --> {target.value}: {names}\n") == 1
    assert "acknowledged --> latched: RETURN, RETURN_UNSEEN (where it latches)" in drawn
    assert "none --> shelved: SHELVE" in drawn
