"""Every storage keeps slow inputs, links, what operators want of them, and traces: one order, no gaps, each once."""

from dataclasses import replace

import numpy as np
import pytest
from example_counts import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.errors import ConflictError, InvalidInputError, NotFoundError
from service.ports.archive import ListPart
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
from service.records.levels.attitude import NO_ANGLES, AppliedCommand, Axes
from service.records.levels.measurement import Measurement, Ring, Trace, TraceReceipt, TraceSettings
from service.records.operations.work import LinkReport, LinkWarning

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
    found = archive.inputs(setting.id, "correction", ListPart(Window(10, 20), 99))
    assert [(e.content.start_us, e.content.stop_us) for e in found] == [(0, 40), (5, 15), (10, 10), (12, 13)]


def test_pages_of_inputs_join(setting):
    archive = setting.storage.archive
    archive.append_inputs(setting.id, [reference(30), reference(10), reference(10, "earth_sensor"), reference(50)])
    numbers, after = [], None
    while page := archive.inputs(setting.id, "reference", ListPart(Window(10, 50), 2, after)):
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
    listed = archive.inputs(setting.id, "operation", ListPart(Window(0, 99), 9))
    assert [entry.content for entry in listed] == [second, changed]
    assert archive.inputs(setting.id, "operation", ListPart(Window(20, 99), 9)) == [listed[0]]
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
        lambda archive: archive.measurements("none", ListPart(Window(0, 1), 1)),
    ],
)
def test_an_unknown_spacecraft_is_named(storage, call):
    with pytest.raises(NotFoundError) as caught:
        call(storage.archive)
    assert caught.value.code == "spacecraft.unknown"


S = 1_000_000
REPORT = LinkReport(
    id="sa-1",
    kind="analyzer",
    spacecraft_id="craft",
    source="sa-1",
    state="MEASURE",
    detail={"identity": "R&S, FSV\u0000", "nested": [1, None, {"x": 0.5}]},
    counters={"sweeps": 1 << 52},
    last_good_us=7,
    warnings=(LinkWarning("spool.full", "half\nfull", 3),),
    reset_seen=1,
)


def test_a_report_comes_back_as_it_was_and_a_new_link_is_enabled(storage):
    (reported,) = storage.links.report([REPORT], 10 * S)
    assert (reported.report, reported.reported_at_us, reported.enabled, reported.resets) == (REPORT, 10 * S, True, 0)
    assert storage.links.link("sa-1") == reported
    assert storage.links.links() == (reported,)


def test_the_newest_report_holds_and_leaves_what_is_wanted_alone(storage):
    storage.links.report([REPORT], 10 * S)
    storage.links.set_enabled("sa-1", enabled=False)
    storage.links.request_reset("sa-1")
    assert storage.links.request_reset("sa-1").resets == 2
    changed = replace(REPORT, state="BACKOFF", reset_seen=2)
    (reported,) = storage.links.report([changed], 20 * S)
    assert (reported.report.state, reported.enabled, reported.resets) == ("BACKOFF", False, 2)
    assert storage.links.set_enabled("sa-1", enabled=True).enabled


def test_links_are_listed_in_order_and_by_spacecraft(storage):
    others = [replace(REPORT, id=name, spacecraft_id=record) for name, record in (("z", "b"), ("a", None), ("m", "b"))]
    storage.links.report(others, S)
    assert [state.report.id for state in storage.links.links()] == ["a", "m", "z"]
    assert [state.report.id for state in storage.links.links("b")] == ["m", "z"]
    assert storage.links.links("c") == ()


def test_the_period_is_learned_and_one_outage_does_not_undo_it(storage):
    for k in range(20):
        (reported,) = storage.links.report([REPORT], (100 + 10 * k) * S)
    assert reported.period_s == pytest.approx(10.0)
    assert not reported.is_silent((290 + 30) * S)
    assert reported.is_silent((290 + 31) * S)
    (after,) = storage.links.report([REPORT], 10_000 * S)
    assert after.period_s == pytest.approx(15.0)
    # a stated one needs no learning
    (stated,) = storage.links.report([replace(REPORT, period_s=300.0)], 10_010 * S)
    assert stated.period_s == 300.0


def test_a_clock_that_went_back_teaches_no_negative_period(storage):
    storage.links.report([REPORT], 100 * S)
    assert storage.links.report([REPORT], 50 * S)[0].period_s >= 1.0


def test_an_unknown_link_is_told_so(storage):
    for call in (
        lambda: storage.links.link("x"),
        lambda: storage.links.set_enabled("x", enabled=True),
        lambda: storage.links.request_reset("x"),
        lambda: storage.links.remove("x"),
    ):
        with pytest.raises(NotFoundError) as caught:
            call()
        assert caught.value.code == "link.unknown"


def test_a_removed_link_comes_back_new(storage):
    storage.links.report([REPORT], S)
    storage.links.set_enabled("sa-1", enabled=False)
    storage.links.remove("sa-1")
    assert storage.links.links() == ()
    assert storage.links.report([REPORT], S)[0].enabled


def test_invented_ids_come_to_an_end_and_known_links_go_on(storage):
    storage.links.report([replace(REPORT, id=f"l{k}") for k in range(1000)], S)
    with pytest.raises(ConflictError) as caught:
        storage.links.report([replace(REPORT, id="l0", state="BACKOFF"), replace(REPORT, id="new")], 2 * S)
    assert caught.value.code == "link.too_many"
    # one report is one transaction
    assert storage.links.link("l0").report.state == "MEASURE"
    assert storage.links.report([replace(REPORT, id="l0", state="BACKOFF")], 2 * S)[0].report.state == "BACKOFF"


SETTINGS = TraceSettings(954e6, 15e3, 30e3, 31.5e3, 0.0)
WIDE = Ring(1000, 1 << 30)
EVER = Window(0, 1 << 60)


def trace(epoch_us: int, sweep: str = "tp1", points: int = 7) -> Trace:
    power_dbm = np.random.default_rng(epoch_us).normal(-90.0, 3.0, points).astype(np.float32).astype(np.float64)
    power_dbm[0] = np.nan
    return Trace(epoch_us, sweep, SETTINGS, power_dbm)


def epochs_of(setting, **options) -> list[int]:
    heads = setting.storage.traces.heads(setting.id, ListPart(EVER, 10_000), **options)
    return [head.epoch_us for head in heads]


def append(setting, traces, ring: Ring = WIDE, source: str = "sa-1") -> TraceReceipt:
    return setting.storage.traces.append(setting.id, source, traces, 77, ring)


@pytest.mark.parametrize("points", [1, 2, 2401])
def test_a_trace_comes_back_bit_for_bit(setting, points):
    sent = trace(10, points=points)
    assert append(setting, [sent]) == TraceReceipt(1, 0, 0)
    kept = setting.storage.traces.trace(setting.id, 10)
    # float32 values: no tolerance
    np.testing.assert_array_equal(kept.power_dbm, sent.power_dbm)
    head = kept.head
    assert (head.source, head.sweep, head.settings, head.points, head.received_at_us) == (
        "sa-1",
        "tp1",
        SETTINGS,
        points,
        77,
    )
    with pytest.raises(ValueError, match="read-only"):
        kept.power_dbm[0] = 0


def test_source_sweep_and_epoch_are_the_key_and_the_first_one_stays(setting):
    first, again = trace(10), Trace(10, "tp1", SETTINGS, np.zeros(3))
    assert append(setting, [first, again]) == TraceReceipt(1, 1, 0)
    assert append(setting, [again, trace(10, "tp2"), trace(11)]) == TraceReceipt(2, 1, 0)
    assert append(setting, [trace(10)], source="sa-2") == TraceReceipt(1, 0, 0)
    assert setting.storage.traces.trace(setting.id, 10, "sa-1", "tp1").head.points == 7
    with pytest.raises(ConflictError) as caught:
        setting.storage.traces.trace(setting.id, 10, "sa-1")
    assert caught.value.code == "trace.ambiguous"


def test_unknown_traces_and_spacecraft_are_told(setting):
    append(setting, [trace(10)])
    for options in ({"epoch_us": 11}, {"epoch_us": 10, "source": "sa-2"}, {"epoch_us": 10, "sweep": "tp2"}):
        with pytest.raises(NotFoundError) as caught:
            setting.storage.traces.trace(setting.id, **options)
        assert caught.value.code == "trace.unknown"
    with pytest.raises(NotFoundError) as record:
        setting.storage.traces.append("nobody", "sa-1", [trace(1)], 1, WIDE)
    assert record.value.code == "spacecraft.unknown"


def test_the_ring_keeps_the_newest_epochs_of_each_source(setting):
    small = Ring(3, 1 << 30)
    assert append(setting, [trace(k) for k in (10, 20, 30)], small).dropped == 0
    assert append(setting, [trace(k) for k in (40, 50)], small) == TraceReceipt(2, 0, 2)
    # sent late: older than all that is kept, so it goes at once
    assert append(setting, [trace(5)], small) == TraceReceipt(1, 0, 1)
    assert append(setting, [trace(1)], small, source="sa-2") == TraceReceipt(1, 0, 0)
    assert epochs_of(setting) == [1, 30, 40, 50]


def test_the_ring_is_bounded_by_bytes_too(setting):
    append(setting, [trace(k, points=500) for k in range(1, 9)])
    (size,) = {head.size_bytes for head in setting.storage.traces.heads(setting.id, ListPart(EVER, 1))}
    kept = append(setting, [trace(9, points=500)], Ring(1000, 4 * size))
    assert kept.accepted == 1
    heads = setting.storage.traces.heads(setting.id, ListPart(EVER, 100))
    assert sum(head.size_bytes for head in heads) <= 4 * size
    assert [head.epoch_us for head in heads][-1] == 9
    assert len(heads) >= 3


def test_a_ring_of_nothing_keeps_nothing(setting):
    append(setting, [trace(k) for k in range(1, 700)])
    assert append(setting, [trace(800)], Ring(0, 1 << 30)) == TraceReceipt(1, 0, 700)
    assert epochs_of(setting) == []


def test_pages_of_heads_join_and_filters_choose(setting):
    append(setting, [trace(10), trace(20), trace(20, "tp2"), trace(30)])
    append(setting, [trace(20)], source="sa-2")
    traces, after, pages = setting.storage.traces, None, []
    while page := traces.heads(setting.id, ListPart(Window(10, 30), 2, after)):
        pages.append([(head.epoch_us, head.number) for head in page])
        after = pages[-1][-1]
    assert [epoch_us for page in pages for epoch_us, _ in page] == [10, 20, 20, 20]
    assert len({number for page in pages for _, number in page}) == 4
    assert epochs_of(setting, source="sa-2") == [20]
    assert epochs_of(setting, sweep="tp2") == [20]
    assert epochs_of(setting, source="sa-2", sweep="tp2") == []
