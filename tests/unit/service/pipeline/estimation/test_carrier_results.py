"""Carriers' results of a row are the method's state after that row."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import Flight, FlightPayload

from service.records.catalogue import LIVE_METHODS
from service.records.levels.carrier_results import CARRIER_HYPOTHESES, CARRIER_STATES

PAYLOAD = FlightPayload.make()


@pytest.fixture
def flight():
    """A chain of both methods, just aligned."""
    return Flight(PAYLOAD)


def test_results_of_a_row_are_the_states_after_it(flight):
    seen = set()
    for minute in range(1, 40):
        measured = flight.row(minute)
        power_dbm = measured.power_dbm.copy()
        power_dbm[2] = np.nan
        power_dbm[4] -= 3.0 * (minute > 20)
        outcome = flight.chain.step(replace(measured, power_dbm=power_dbm))
        assert len(outcome.rows) == len(outcome.carriers) == len(LIVE_METHODS)
        found = outcome.carriers[0]
        _, states = flight.chain.carrier_states()
        assert found.plan_id == measured.plan_id
        assert [CARRIER_STATES[code] for code in found.state] == [state.state for state in states]
        assert [CARRIER_HYPOTHESES[code] for code in found.hypothesis] == [state.hypothesis for state in states]
        np.testing.assert_array_equal(found.deviation_db, [state.deviation_db for state in states])
        np.testing.assert_array_equal(found.residual_db, [state.residual_db for state in states])
        for each, row in zip(outcome.carriers, outcome.rows, strict=True):
            assert CARRIER_STATES[each.state[2]] == "absent"
            left_out = np.flatnonzero(each.state == CARRIER_STATES.index("excluded"))
            assert {PAYLOAD.ids[k] for k in left_out} <= {exclusion.carrier for exclusion in row.excluded}
            seen.update((row.method, int(k)) for k in left_out)
    assert {(method, 4) for method in LIVE_METHODS} <= seen


def test_a_late_row_and_a_method_that_fails_have_none(flight, monkeypatch):
    assert None not in flight.chain.step(flight.row(5)).carriers
    assert flight.chain.step(flight.row(3)).carriers == ()

    def fail(*_args, **_others):
        raise ValueError

    monkeypatch.setattr("service.pipeline.estimation.robust.runner.step_with_record", fail)
    outcome = flight.chain.step(flight.row(6))
    assert outcome.rows[0].inhibitions == ("internal_error",)
    assert [each is None for each in outcome.carriers] == [True, False]
