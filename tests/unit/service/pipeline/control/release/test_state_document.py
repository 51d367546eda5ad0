"""The stored text of a state comes back equal, whatever happened before; a text that is none is refused."""

import json
import math
from dataclasses import replace

import pytest
from release_driver import GOOD, ReleaseDriver

from service.pipeline.control.release.events import OrderKind, ReleaseState
from service.pipeline.control.release.state_document import document_of, state_of
from service.records.levels.attitude import Axes
from service.records.operations.release import SignCheck, SignRatios

#: of states without commands
NO_COMMAND = {}.__getitem__


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
    check = SignCheck("roll", "running", 5, "ann", 9, 4, 1, log_ratio=SignRatios(0.0, -3.5, -math.inf))
    for state in (driver.state, replace(driver.state, sign_check=check)):
        assert state_of(document_of(state), driver.command) == state


def test_not_a_number_and_infinity_come_back():
    driver = ReleaseDriver().armed()
    driver.rows(1, replace(GOOD, attitude_deg=Axes(math.nan, -0.0, math.inf)))
    angles = state_of(document_of(driver.state), driver.command).interlock.row.attitude_deg
    assert repr(tuple(angles)) == "(nan, -0.0, inf)"


def test_of_commands_the_counters_are_stored():
    driver = ReleaseDriver().engaged()
    driver.automatic(is_reported=False)
    assert json.loads(document_of(driver.state))["state"]["commands"] == [1]


def test_an_empty_text_is_the_state_before_the_first_event():
    assert state_of("", NO_COMMAND) == ReleaseState()


@pytest.mark.parametrize(
    "change",
    [
        {"next_counter": "one"},
        {"interlock": {"state": "OPEN"}},
        {"commands": [{"state": "SENT"}]},
        {"former": 7},
        {"sent": 5},
        {"interlock": None},
        {"sent": [{"at_us": 1, "impulse_n_m_s": [0.0]}]},
    ],
)
def test_a_text_that_does_not_fit_is_refused(change):
    document = json.loads(document_of(ReleaseState()))
    with pytest.raises(ValueError, match=r"."):
        state_of(json.dumps({**document, "state": {**document["state"], **change}}), NO_COMMAND)
