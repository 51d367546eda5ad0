"""The stored text of a state comes back equal, whatever happened before; a text that is none is refused."""

import json
import math
from dataclasses import replace

import pytest
from release_driver import GOOD, ReleaseDriver

from service.pipeline.control.release.events import OrderKind
from service.pipeline.control.release.state_document import ReleaseMemory, document_of, memory_of
from service.records.levels.attitude import Axes
from service.records.operations.release import SignCheckView, SignRatios


def stories():
    yield ReleaseDriver()
    engaged = ReleaseDriver().engaged()
    engaged.automatic(is_reported=False)
    yield engaged
    armed = ReleaseDriver().armed()
    armed.engage("ann")
    armed.prepare()
    yield armed
    armed.order(OrderKind.STOP)
    yield armed


@pytest.mark.parametrize("driver", list(stories()))
def test_a_state_comes_back_equal(driver):
    check = SignCheckView("roll", "running", 5, "ann", 9, 4, 1, log_ratio=SignRatios(0.0, -3.5, -math.inf))
    for memory in (ReleaseMemory(driver.state), ReleaseMemory(driver.state, check)):
        assert memory_of(document_of(memory)) == memory


def test_not_a_number_and_infinity_come_back():
    driver = ReleaseDriver().armed()
    driver.rows(1, replace(GOOD, attitude_deg=Axes(math.nan, -0.0, math.inf)))
    angles = memory_of(document_of(ReleaseMemory(driver.state))).state.interlock.row.attitude_deg
    assert repr(tuple(angles)) == "(nan, -0.0, inf)"


def test_a_field_that_was_renamed_is_stored_under_its_first_name():
    document = json.loads(document_of(ReleaseMemory(ReleaseDriver().armed().state)))
    assert document["state"]["interlock"]["around"]["calibration_id"] == 7


def test_an_empty_text_is_the_state_before_the_first_event():
    assert memory_of("") == ReleaseMemory()


def test_a_field_that_is_not_there_takes_its_default_and_one_too_many_is_passed_over():
    document = json.loads(document_of(ReleaseMemory(ReleaseDriver().armed().state)))
    del document["state"]["interlock"]["proven_axes"]
    document["state"]["interlock"]["former"] = 7
    assert memory_of(json.dumps(document)).state.interlock.proven_axes == ()


@pytest.mark.parametrize(
    "change",
    [
        {"next_counter": "one"},
        {"interlock": {"state": "OPEN"}},
        {"commands": [{"counter": 1}]},
        {"sent": 5},
        {"interlock": None},
        {"sent": [{"at_us": 1, "impulse_n_m_s": [0.0]}]},
    ],
)
def test_a_text_that_does_not_fit_is_refused(change):
    document = json.loads(document_of(ReleaseMemory()))
    with pytest.raises(ValueError, match=r"."):
        memory_of(json.dumps({"state": {**document["state"], **change}}))
