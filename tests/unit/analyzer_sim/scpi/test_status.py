"""Registers, summary bits and the error queue."""

import pytest

from analyzer_sim.scpi.errors import ERROR_TEXTS, error_entry, event_bit
from analyzer_sim.scpi.status import StatusModel, StatusRegister


@pytest.mark.parametrize(("code", "bit"), [(-113, 5), (-222, 4), (-350, 3), (-410, 2)])
def test_class_of_an_error_sets_its_event_bit(code: int, bit: int) -> None:
    status = StatusModel()
    status.pop_event()
    status.push_error(code)
    assert status.pop_event() == 1 << bit


def test_every_error_belongs_to_a_class() -> None:
    assert {event_bit(code) for code in ERROR_TEXTS if code} == {2, 3, 4, 5}


def test_queue_is_first_in_first_out_and_ends_with_no_error() -> None:
    status = StatusModel()
    status.push_error(-113, "A")
    status.push_error(-222)
    answers = [status.pop_error() for _ in range(3)]
    assert answers == ['-113,"Undefined header;A"', '-222,"Data out of range"', '0,"No error"']


def test_overflow_replaces_the_last_entry() -> None:
    status = StatusModel(error_queue_depth=20)
    for _ in range(20 + 5):
        status.push_error(-113)
    assert status.error_count == 20
    answers = status.pop_all_errors().split('",')
    assert answers[-1] == '-350,"Queue overflow"'
    assert all(answer.startswith("-113") for answer in answers[:-1])
    assert status.pop_event() & 1 << 3


def test_all_of_an_empty_queue_is_no_error() -> None:
    assert StatusModel().pop_all_errors() == '0,"No error"'


def test_detail_is_one_printable_string() -> None:
    assert error_entry(-101, 'a"b\n\xff') == '-101,"Invalid character;a\'b.."'


def test_power_on_is_set_once() -> None:
    status = StatusModel()
    assert status.pop_event() == 128
    assert status.pop_event() == 0


def test_status_byte_sums_every_source() -> None:
    status = StatusModel()
    status.pop_event()
    assert status.status_byte(has_response=False) == 0
    assert status.status_byte(has_response=True) == 16
    status.push_error(-113)
    assert status.status_byte(has_response=False) == 4
    status.event_enable = 32
    assert status.status_byte(has_response=False) == 4 + 32
    status.service_enable = 32
    assert status.status_byte(has_response=False) == 4 + 32 + 64
    status.questionable.put_enable(8)
    status.put_questionable_power(1)
    status.operation.put_enable(32)
    status.operation.put_bit(32, is_set=True)
    assert status.status_byte(has_response=False) == 4 + 8 + 32 + 64 + 128


def test_clear_empties_events_and_errors_but_not_enables() -> None:
    status = StatusModel()
    status.push_error(-113)
    status.event_enable = 60
    status.operation.put_enable(8)
    status.operation.put_bit(8, is_set=True)
    status.clear()
    assert (status.event, status.error_count, status.operation.event) == (0, 0, 0)
    assert (status.event_enable, status.operation.enable, status.operation.condition) == (60, 8, 8)
    status.preset()
    assert (status.event_enable, status.operation.enable) == (60, 0)


def test_register_latches_rising_edges_only() -> None:
    register = StatusRegister()
    register.put_bit(4, is_set=True)
    assert register.pop_event() == 4
    register.put_bit(4, is_set=True)
    assert register.pop_event() == 0
    register.put_bit(4, is_set=False)
    assert (register.condition, register.pop_event()) == (0, 0)
    register.put_enable(0xFFFF)
    assert register.enable == 0x7FFF


def test_filters_of_edges_decide_what_is_latched() -> None:
    register = StatusRegister()
    register.rising, register.falling = 2, 4
    register.put_condition(7)
    assert register.pop_event() == 2
    register.put_condition(0)
    assert register.pop_event() == 4
    register.preset()
    register.put_condition(7)
    assert register.pop_event() == 7
