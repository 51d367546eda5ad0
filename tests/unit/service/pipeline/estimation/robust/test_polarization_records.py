"""Angles of polarimeters on their way to the filter."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import MINUTE
from stepped_robust import ALIGNED_US, PAYLOAD, Stepped

from service.core.estimation.filtering.model.filter_state import ATTITUDE
from service.pipeline.estimation.robust.method import RobustState
from service.pipeline.estimation.robust.polarization_records import with_polarization
from service.records.catalogue import Polarimeter
from service.records.inputs import PolarizationRecord

STATED = Polarimeter("p", 10.0, 11e9)


def read(angles_deg: dict[int, float], *, is_used: bool = True) -> tuple[RobustState, RobustState]:
    """Return the state at an alignment, and after the angles of some minutes, in blocks of five."""
    craft = replace(PAYLOAD.spacecraft(), polarimeters=(replace(STATED, used=is_used),))
    flight = Stepped(spacecraft=craft)
    state, records = flight.state, []
    for minute, angle_deg in angles_deg.items():
        records.append(PolarizationRecord("p", ALIGNED_US + minute * MINUTE, angle_deg=angle_deg, sigma_deg=0.01))
        knowledge = replace(flight.knowledge, polarization={"p": tuple(records)})
        state = replace(state, filter=state.filter._replace(epoch_us=ALIGNED_US + minute * MINUTE))
        state, _ = with_polarization(state, flight.model, knowledge)
    return flight.state, state


def test_the_first_angle_sets_the_offset_and_a_change_after_it_counts_as_yaw() -> None:
    before, first = read({5: 1.7})
    yaw, sigma = ATTITUDE.start, np.sqrt(before.filter.gaussian.covariance[0, 0])
    assert first.polarimeters[0].newest_us == ALIGNED_US + 5 * MINUTE
    assert first.filter.gaussian.mean[yaw] == pytest.approx(before.filter.gaussian.mean[yaw], abs=0.05 * sigma)
    _, second = read({5: 1.7, 10: 1.74})
    assert second.polarimeters[0].blocks > 1.9
    assert second.filter.gaussian.mean[yaw] > first.filter.gaussian.mean[yaw]


def test_an_angle_that_is_not_due_and_a_polarimeter_that_is_not_used_change_nothing() -> None:
    _, two = read({5: 1.7, 9: 1.9})
    _, one = read({5: 1.7})
    np.testing.assert_array_equal(two.filter.gaussian.mean, one.filter.gaussian.mean)
    before, unused = read({5: 1.7}, is_used=False)
    assert unused.polarimeters == ()
    assert unused.filter.gaussian is before.filter.gaussian
