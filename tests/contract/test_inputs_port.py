"""Every storage journals slow inputs with the measurements: one order, no gaps, each key once."""

from dataclasses import replace

import numpy as np
import pytest
from example_counts import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.errors import InvalidInputError, NotFoundError
from service.records.calibration import Window
from service.records.inputs import (
    AlignmentSet,
    AttitudeReference,
    CalibrationActivation,
    Correction,
    EphemerisChange,
    Operation,
    PlanChange,
    PolarizationRecord,
    SourceSelection,
    TelemetryRecord,
    WeatherReport,
)
from service.records.levels.attitude import NO_ANGLES, Axes
from service.records.levels.command import AppliedCommand
from service.records.levels.measurement import Measurement

NAN = float("nan")


def reference(epoch_us, source="star_tracker", roll=0.1):
    return AttitudeReference(source, epoch_us, Axes(NAN, roll, -0.0), Axes(NAN, 0.03, 0.04))


def contents(setting, after=3):
    return [entry.content for entry in setting.storage.archive.journal(setting.id, after, 1000)]


def test_slow_inputs_come_back_equal_in_the_order_of_the_journal(setting):
    sent = [
        Correction(10, 20, Axes(0.1, 0.2, 0.30000000000000004)),
        TelemetryRecord(
            15, "FORECAST", (1.0, -2.0), None, thrusters_active=True, body_rate_deg_s=Axes(1e-300, 0.0, 5e-324)
        ),
        TelemetryRecord(16),
        WeatherReport("radar", "Kyiv / Київ", 17, 0.1, None),
        PolarizationRecord("p", 18, -15.3, -55.0, None, 0.1, tec_tecu=5e-324),
    ]
    receipt = setting.storage.archive.append_inputs(setting.id, sent)
    assert (receipt.accepted, receipt.duplicates, receipt.refused) == (5, 0, ())
    assert contents(setting) == sent


@settings(
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    max_examples=examples(40),
)
@given(figures=st.lists(st.floats(), min_size=6, max_size=6), epoch_us=st.integers(0, 1 << 53))
def test_every_float_survives_bit_for_bit(new_setting, figures, epoch_us):
    setting = new_setting()
    sent = AttitudeReference("other", epoch_us, Axes(*figures[:3]), Axes(*figures[3:]))
    setting.storage.archive.append_inputs(setting.id, [sent])
    (stored,) = contents(setting)
    expected, found = (np.array([*record.attitude_deg, *record.sigma_deg]) for record in (sent, stored))
    # one NaN stands for all of them; everything else is compared as bits
    expected[np.isnan(expected)] = np.nan
    assert found.tobytes() == expected.tobytes()
    assert stored.epoch_us == epoch_us


def test_the_same_input_again_is_a_duplicate_and_another_content_a_conflict(setting):
    sent = [reference(10), reference(10), reference(10, roll=0.2), reference(10, "earth_sensor")]
    receipt = setting.storage.archive.append_inputs(setting.id, sent)
    assert (receipt.accepted, receipt.duplicates) == (2, 1)
    assert [(refusal.index, refusal.code) for refusal in receipt.refused] == [(2, "input.conflict")]
    again = setting.storage.archive.append_inputs(setting.id, sent)
    assert (again.accepted, again.duplicates, len(again.refused)) == (0, 3, 1)
    assert len(contents(setting)) == 2


def test_an_input_with_integers_for_floats_is_the_same_input(setting):
    setting.storage.archive.append_inputs(setting.id, [Correction(1, 2, Axes(1.0, 2.0, 3.0))])
    assert setting.storage.archive.append_inputs(setting.id, [Correction(1, 2, Axes(1, 2, 3))]).duplicates == 1


def test_no_inputs_are_a_receipt_of_nothing(setting):
    receipt = setting.storage.archive.append_inputs(setting.id, [])
    assert (receipt.accepted, receipt.duplicates, receipt.refused) == (0, 0, ())


def test_what_a_call_of_its_own_journals_is_refused_here(setting):
    with pytest.raises(InvalidInputError) as caught:
        setting.storage.archive.append_inputs(setting.id, [reference(10), PlanChange(1)])
    assert caught.value.code == "input.kind"
    assert contents(setting) == []


def test_every_accepted_input_has_the_next_number(setting, make):
    archive = setting.storage.archive
    setting.append([10, 20])
    archive.append_inputs(setting.id, [reference(12)])
    operation = archive.add_operation(setting.id, Operation(0, "eclipse", 5, None))
    setting.append([30])
    setting.storage.catalogue.put_plan(setting.id, make.carriers[:2], "short")
    archive.select_source(setting.id, "sa-1")
    setting.calibrate()
    setting.align(15)
    entries = archive.journal(setting.id, 2, 100)
    assert [entry.number for entry in entries] == list(range(3, 3 + len(entries)))
    kinds = [type(entry.content) for entry in entries]
    assert kinds == [
        EphemerisChange,
        Measurement,
        Measurement,
        AttitudeReference,
        Operation,
        Measurement,
        PlanChange,
        SourceSelection,
        CalibrationActivation,
        AlignmentSet,
    ]
    assert entries[4].content == operation
    assert entries[7].content == SourceSelection("sa-1", 1)


def test_pages_of_the_journal_join(setting):
    setting.append([10, 20, 30])
    setting.storage.archive.append_inputs(setting.id, [reference(12), reference(13)])
    numbers, after = [], 0
    while page := setting.storage.archive.journal(setting.id, after, 3):
        assert len(page) <= 3
        numbers += [entry.number for entry in page]
        after = numbers[-1]
    assert numbers == list(range(1, 9))


def test_journals_of_two_spacecraft_do_not_mix(new_setting):
    one, other = new_setting(), new_setting()
    one.append([10])
    other.append([20, 30])
    one.storage.archive.append_inputs(one.id, [reference(1)])
    assert [type(content) for content in contents(one)] == [Measurement, AttitudeReference]
    assert one.storage.archive.head(one.id).newest_number == 5
    assert other.storage.archive.head(other.id).newest_number == 5


def test_slow_inputs_before_a_number_are_chosen_by_kind(setting):
    archive = setting.storage.archive
    setting.append([10])
    archive.append_inputs(setting.id, [reference(1), Correction(1, 2, NO_ANGLES), reference(2)])
    entries = archive.slow_inputs_before(setting.id, 7, ["reference", "correction"])
    assert [entry.number for entry in entries] == [5, 6]
    assert [entry.number for entry in archive.slow_inputs_before(setting.id, 99, ["reference"])] == [5, 7]
    assert archive.slow_inputs_before(setting.id, 99, []) == []


def test_inputs_of_a_window_are_those_that_overlap_it(setting):
    archive = setting.storage.archive
    spans = [(0, 10), (5, 15), (12, 13), (0, 40), (20, 30), (10, 10)]
    archive.append_inputs(setting.id, [Correction(start, stop, NO_ANGLES) for start, stop in spans])
    found = archive.inputs(setting.id, "correction", Window(10, 20), 99, None)
    assert [(e.content.start_us, e.content.stop_us) for e in found] == [(0, 40), (5, 15), (10, 10), (12, 13)]


def test_pages_of_inputs_join(setting):
    archive = setting.storage.archive
    archive.append_inputs(setting.id, [reference(30), reference(10), reference(10, "earth_sensor"), reference(50)])
    numbers, after = [], None
    while page := archive.inputs(setting.id, "reference", Window(10, 50), 2, after):
        numbers += [entry.number for entry in page]
        after = (page[-1].content.epoch_us, page[-1].number)
    assert numbers == [5, 6, 4]


def test_an_operation_is_revised_and_listed_in_its_newest_revision(setting):
    archive = setting.storage.archive
    declared = Operation(0, "station_keeping", 5, None, ("c00",), None, inhibit_control=True, comment="North")
    first = archive.add_operation(setting.id, declared)
    second = archive.add_operation(setting.id, replace(declared, kind="eclipse"))
    changed = archive.replace_operation(setting.id, replace(first, stop_us=9))
    assert (first.id, second.id, changed.revision) == (1, 2, 2)
    assert archive.operation(setting.id, 1) == changed
    listed = archive.inputs(setting.id, "operation", Window(0, 99), 9, None)
    assert [entry.content for entry in listed] == [second, changed]
    assert archive.inputs(setting.id, "operation", Window(20, 99), 9, None) == [listed[0]]
    assert contents(setting) == [first, second, changed]
    for call in (
        lambda: archive.operation(setting.id, 3),
        lambda: archive.replace_operation(setting.id, replace(first, id=3)),
    ):
        with pytest.raises(NotFoundError) as caught:
            call()
        assert caught.value.code == "operation.unknown"


@pytest.mark.parametrize("page_rows", [1, 3, 99])
def test_references_come_as_arrays_by_sensor(setting, monkeypatch, page_rows):
    monkeypatch.setattr("db.measurements.archive.RECORD_PAGE_ROWS", page_rows)
    sent = [reference(30, roll=0.3), reference(10, roll=0.1), reference(20, "earth_sensor"), reference(99)]
    setting.storage.archive.append_inputs(setting.id, sent)
    earth, star = setting.storage.archive.reference_series(setting.id, Window(0, 99))
    assert (earth.source, earth.epochs_us.tolist()) == ("earth_sensor", [20])
    assert (star.source, star.epochs_us.tolist()) == ("star_tracker", [10, 30])
    np.testing.assert_array_equal(star.attitude_deg, [[NAN, 0.1, 0.0], [NAN, 0.3, 0.0]])
    np.testing.assert_array_equal(star.sigma_deg, [[NAN, 0.03, 0.04]] * 2)
    assert setting.storage.archive.reference_series(setting.id, Window(100, 200)) == ()


def test_an_applied_command_can_be_reported(setting, make):
    setting.append([10])
    (row,) = setting.rows()
    applied = AppliedCommand(make.torque_command(row))
    assert setting.storage.archive.append_inputs(setting.id, [applied, applied]).duplicates == 1
    assert contents(setting)[-1] == applied


@pytest.mark.parametrize(
    "call",
    [
        lambda archive: archive.head("none"),
        lambda archive: archive.journal("none", 0, 1),
        lambda archive: archive.sources("none"),
        lambda archive: archive.append_inputs("none", []),
        lambda archive: archive.newest_measurement("none"),
        lambda archive: archive.measurements("none", Window(0, 1), 1, None),
    ],
)
def test_an_unknown_spacecraft_is_named(storage, call):
    with pytest.raises(NotFoundError) as caught:
        call(storage.archive)
    assert caught.value.code == "spacecraft.unknown"
