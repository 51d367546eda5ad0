"""Flights on disk come back equal; those of another length or setting are flown again."""

import numpy as np
import pytest

from service.study.closed_loop.controllers import Sensing
from service.study.closed_loop.flight_store import keep, kept
from service.study.closed_loop.run import FlownRun, LoopResult, LoopUnit

UNIT = LoopUnit("nominal", 3, Sensing.AUTOMATIC, "link", 0.5, (0.1, 0.2, 0.3))


def flight() -> FlownRun:
    rng = np.random.default_rng(1)
    flags = rng.uniform(size=5) < 0.5
    return FlownRun(
        np.arange(5.0), rng.normal(size=(5, 3)), np.full((5, 3), np.nan), flags, ~flags, (0.1, 0.2, 0.3), 7, {"late": 1}
    )


def test_a_flight_comes_back_as_it_was_kept(tmp_path):
    result = LoopResult(UNIT, 12.5, "", flight())
    keep(tmp_path / "new", result)
    again = kept(tmp_path / "new", UNIT)
    assert (again.unit, again.seconds, again.refusal) == (UNIT, 12.5, "")
    for name in ("hours", "truth_deg", "estimate_deg", "is_inhibited", "is_faded"):
        np.testing.assert_array_equal(getattr(again.flight, name), getattr(result.flight, name))
    assert (again.flight.impulse_n_m_s, again.flight.sent, again.flight.reported) == ((0.1, 0.2, 0.3), 7, {"late": 1})
    assert not list((tmp_path / "new").glob("*.half"))


@pytest.mark.parametrize("changes", [{"operation_days": 1.0}, {"yaw_sigma_deg": 0.2}, {"drift_deg_h": None}])
def test_a_unit_of_another_setting_is_not_there(tmp_path, changes):
    keep(tmp_path, LoopResult(UNIT, 1.0, "no calibration"))
    assert kept(tmp_path, UNIT._replace(**changes)) is None
    assert kept(tmp_path, UNIT._replace(seed=4)) is None
    assert kept(tmp_path, UNIT) == LoopResult(UNIT, 1.0, "no calibration")
