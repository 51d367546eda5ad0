"""Results of carriers come back to half a step, what is not known stays so."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from db.encoding.carrier_codec import pack_carriers, unpack_carriers
from service.core.estimation.filtering.anchor.carrier_mixture import HYPOTHESES
from service.records.levels.carrier_results import CARRIER_HYPOTHESES, CARRIER_STATES, STEP_DB, CarrierResults

LEVELS = st.floats(-131.0, 131.0) | st.just(float("nan"))


@settings(derandomize=True, deadline=None)
@given(data=st.data(), count=st.integers(1, 40))
def test_what_is_stored_comes_back(data, count):
    def column(values):
        return np.array(data.draw(st.lists(values, min_size=count, max_size=count)))

    state, hypothesis = (column(st.integers(0, len(names) - 1)) for names in (CARRIER_STATES, CARRIER_HYPOTHESES))
    stored = CarrierResults(data.draw(st.integers(1, 2**31 - 1)), column(LEVELS), column(LEVELS), state, hypothesis)
    found = unpack_carriers(pack_carriers(stored))
    assert found.plan_id == stored.plan_id
    for name in ("deviation_db", "residual_db"):
        np.testing.assert_allclose(getattr(found, name), getattr(stored, name), rtol=0, atol=0.5001 * STEP_DB)
    np.testing.assert_array_equal(found.state, stored.state)
    np.testing.assert_array_equal(found.hypothesis, stored.hypothesis)
    # stored again it is the same
    assert pack_carriers(found) == pack_carriers(stored)


def test_a_level_beyond_all_is_the_greatest_one():
    nothing = np.zeros(3, dtype=np.int64)
    levels = np.array([1e9, -1e9, np.inf])
    found = unpack_carriers(pack_carriers(CarrierResults(1, levels, levels, nothing, nothing)))
    assert found.deviation_db.tolist() == [131.068, -131.068, 131.068]


def test_hypotheses_are_those_of_the_filter():
    assert (None, *HYPOTHESES) == CARRIER_HYPOTHESES
