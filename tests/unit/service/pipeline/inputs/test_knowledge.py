"""Knowledge: each slow input changes what it speaks of, the rest stays."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic_payload as synthetic

from service.pipeline.inputs.knowledge import Knowledge, update
from service.records.calibration import CalibrationMethod
from service.records.catalogue import Method, Station
from service.records.inputs import CalibrationActivation, Correction, Operation, SourceSelection, WeatherReport
from service.records.levels.attitude import Axes


@pytest.fixture
def documents(payload):
    """Documents of a spacecraft; calibration 2 is one by station geometry."""
    held = synthetic.FixedDocuments(payload, synthetic.START_US)
    request = replace(payload.request, method=CalibrationMethod.GEOMETRY)
    held.calibrations[2] = replace(payload.calibration(2), request=request)
    return held


@pytest.fixture
def knowledge(payload, documents):
    """What the opening of a journal tells."""
    known = Knowledge()
    for content in synthetic.opening(payload.spacecraft()):
        known = update(known, content, documents)
    return known


def test_the_opening_tells_everything(knowledge, payload):
    assert knowledge.spacecraft == payload.spacecraft()
    assert knowledge.plan.carrier_ids == payload.ids
    assert knowledge.ephemeris == payload.ephemeris()
    assert knowledge.alignment.id == 1
    assert knowledge.calibration_for(Method.PAPER).id == 1
    assert knowledge.calibration_for(Method.ROBUST) is None


def test_knowledge_before_is_not_changed_by_what_comes_after(knowledge, documents):
    later = update(knowledge, CalibrationActivation(2, 2), documents)
    assert knowledge.calibration_for(Method.ROBUST) is None
    assert later.calibration_for(Method.ROBUST).id == 2


def test_geometry_serves_paper_only_while_no_paper_one_is_active(documents, knowledge):
    alone = update(Knowledge(), CalibrationActivation(2, 1), documents)
    assert alone.calibration_for(Method.PAPER).id == 2
    both = update(knowledge, CalibrationActivation(2, 2), documents)
    assert both.calibration_for(Method.PAPER).id == 1


def test_nothing_is_known_before_the_first_input():
    assert Knowledge().calibration_for(Method.PAPER) is None


@pytest.mark.parametrize("content", [Correction(1, 2, Axes(0.1, 0.1, 0.1)), SourceSelection("sa-2", 1)])
def test_inputs_that_no_method_uses_yet_change_nothing(knowledge, documents, content):
    assert update(knowledge, content, documents) is knowledge


def test_reported_rain_belongs_to_the_carriers_of_the_station(knowledge, documents, payload):
    assert knowledge.reported_wet(payload.ids, 0) is None
    carriers = tuple(
        replace(carrier, station=Station(0.0, 0.0, name))
        for carrier, name in zip(
            knowledge.plan.carriers, ["Kyiv", "Kyiv", "Minsk", ""] * len(payload.ids), strict=False
        )
    )
    named = replace(knowledge, plan=replace(knowledge.plan, carriers=carriers))
    for report in (WeatherReport("radar", "Kyiv", 0, 4.0), WeatherReport("radar", "Minsk", 0, 0.0)):
        named = update(named, report, documents)
    np.testing.assert_array_equal(named.reported_wet([*payload.ids[:4], "c99"], 0), [1.0, 1.0, 0.0, np.nan, np.nan])


@pytest.mark.parametrize(
    ("changes", "at_us", "stands"),
    [
        ({}, 100, True),
        ({}, 99, False),
        ({}, 200, False),
        ({}, 199, True),
        ({"stop_us": None}, 10**18, True),
        ({"inhibit_control": False}, 150, False),
    ],
)
def test_an_operation_forbids_control_from_start_to_stop(documents, changes, at_us, stands):
    operation = replace(Operation(4, "eclipse", 100, 200, inhibit_control=True), **changes)
    known = update(Knowledge(), operation, documents)
    assert bool(known.inhibiting_operations(at_us)) == stands


def test_the_newest_revision_of_an_operation_holds(documents):
    first = Operation(4, "eclipse", 100, 200, inhibit_control=True)
    known = update(Knowledge(), first, documents)
    known = update(known, replace(first, stop_us=120, revision=2), documents)
    known = update(known, Operation(5, "other", 140, 160, inhibit_control=True), documents)
    assert [known.inhibiting_operations(t) != () for t in (110, 130, 150)] == [True, False, True]
