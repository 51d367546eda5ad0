"""The printed curve comes back, sessions are compared with the sensor of each axis, and figures are drawn."""

from types import SimpleNamespace

import numpy as np
import pytest

from service.records.levels.series import ReferenceSeries
from service.study.rf_attitude.figures import draw_reproduction
from service.study.rf_attitude.reproduction import (
    AMPLITUDE_DB,
    OFFSET_DBW,
    PERIOD_H,
    PHASE_RAD,
    RMS_DB,
    Session,
    best_period_h,
    published_curve,
)

MINUTE_US = 60_000_000
ROWS = 720


def test_the_printed_parameters_come_back():
    exact = published_curve(noise_db=0.0).fit
    assert (exact.amplitude_db, exact.phase_rad) == pytest.approx((AMPLITUDE_DB, PHASE_RAD), abs=1e-9)
    for seed in range(1, 6):
        fit = published_curve(seed).fit
        assert fit.amplitude_db == pytest.approx(AMPLITUDE_DB, abs=0.021)
        assert fit.phase_rad == pytest.approx(PHASE_RAD, abs=0.06)
        assert fit.offset_dbm - 30.0 == pytest.approx(OFFSET_DBW, abs=0.015)
        assert fit.rms_db == pytest.approx(RMS_DB, abs=0.011)


def test_the_period_is_told_by_ten_days_and_not_assumed():
    assert best_period_h(published_curve(days=10.0)) == pytest.approx(PERIOD_H, abs=0.025)


@pytest.fixture
def session():
    """Twelve hours: the method is off by 0.05 deg in roll, then by -0.15; a beacon tells yaw each third minute."""
    epochs_us = MINUTE_US * np.arange(ROWS)
    estimate = np.zeros((ROWS, 3))
    estimate[:, 1] = np.where(np.arange(ROWS) < 360, 0.05, -0.15)
    level = np.full((ROWS, 3), (np.nan, 0.0, 0.0))
    yaw = np.full((ROWS // 3, 3), (0.2, np.nan, np.nan))
    witnesses = (
        ReferenceSeries("earth_sensor", epochs_us, level, np.full((ROWS, 3), 0.03)),
        ReferenceSeries("radio_beacon", epochs_us[::3], yaw, np.full((ROWS // 3, 3), 0.1)),
    )
    phases = {"operation": SimpleNamespace(start_us=0)}
    world = SimpleNamespace(
        truth=SimpleNamespace(witnesses=witnesses), ground=SimpleNamespace(epochs_us=epochs_us, phases=phases)
    )
    methods = {name: SimpleNamespace(estimate_deg=estimate) for name in ("paper", "robust")}
    driven = SimpleNamespace(rows=np.arange(ROWS), methods=methods, alignment_deg=np.zeros(3))
    return Session(world, driven)


def test_means_are_those_of_each_session_and_sensor(session):
    assert session.means_deg("paper", 1) == pytest.approx([0.05, -0.15])
    assert session.means_deg("paper", 0) == pytest.approx([-0.2, -0.2])
    assert len(session.differences_deg("robust", 0)[0]) == ROWS // 3


def test_three_figures_are_drawn(session, tmp_path):
    paths = draw_reproduction(session, tmp_path)
    assert [path.name for path in paths] == [f"rf-attitude-figure-{k}.png" for k in (1, 2, 3)]
    assert all(path.stat().st_size > 10_000 for path in paths)
