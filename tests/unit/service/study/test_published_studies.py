"""Studies of published results: limit cycles and attitude by radio."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from service.records.levels.measurement import ReferenceSeries
from service.study.limit_cycles import figures
from service.study.limit_cycles.report import band_table, capture_table, limit_cycle_table, reproduce, schedule_table
from service.study.published import markdown, row
from service.study.rf_attitude import (
    AMPLITUDE_DB,
    OFFSET_DBW,
    PERIOD_H,
    PHASE_RAD,
    RMS_DB,
    Session,
    best_period_h,
    draw_reproduction,
    published_curve,
)

GOOD = row("T, s", "A0", 190.4761905, 190.47619047, "", within=2e-6, digits=10)
BAD = row("w*, rad/s", "A0", 1e-4, 1.1e-4, "", within=1e-10, digits=10)
OPEN = row("w+, rad/s", "kn 0.2", math.inf, math.inf, "")
TABLES = {"T1 Limit cycles": [GOOD, BAD], "T4 Band": [OPEN]}


def test_a_document_has_no_infinity():
    document = json.loads(json.dumps(OPEN.document(), allow_nan=False))
    assert (document["published"], document["ratio"], document["verdict"]) == (None, 1.0, "reproduced")
    assert BAD.document()["verdict"] == "not reproduced"


def test_markdown_has_every_figure():
    text = markdown(TABLES)
    assert "### T1 Limit cycles" in text
    assert "| w*, rad/s | A0 | 0.0001 | 0.00011 | 1.10000000 | not reproduced |" in text
    assert text.count("\n| ") == 2 + 3
    assert "###" not in markdown({"T4 Band": [OPEN]})
    assert OPEN.cells[2:] == ("inf", "inf", "1.00", "reproduced")


def test_the_quick_tables_keep_every_figure():
    for table in (limit_cycle_table(), capture_table(), band_table(), schedule_table()):
        assert len(table) > 10
        assert [each for each in table if each.is_surprising] == []


@pytest.mark.nightly
def test_all_tables_keep_every_figure():
    tables = reproduce()
    assert [each for table in tables.values() for each in table if each.is_surprising] == []
    assert [title[:2] for title in tables] == ["T1", "T2", "T3", "T4", "T5", "T6", "T7"]


NAMES = ["bi-plane", "cycles", "ladder", "stability"]


@pytest.mark.slow
def test_four_figures_as_images(tmp_path):
    paths = figures.draw_figures(tmp_path)
    assert [path.name for path in paths] == [f"limit-cycles-{name}.png" for name in NAMES]
    assert all(path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 20_000 for path in paths)


def test_the_same_figure_is_the_same_file(tmp_path):
    drawn = []
    for name in ("one.svg", "two.svg"):
        with figures.mpl.rc_context({"svg.hashsalt": "soo"}):
            figures._draw_stability(tmp_path / name)
        drawn.append((tmp_path / name).read_bytes())
    assert drawn[0] == drawn[1]


@pytest.mark.parametrize(
    ("published", "reproduced", "within", "is_reproduced"),
    [
        (2.0, 2.0 + 1e-6, 2e-6, True),
        (2.0, 2.0 + 3e-6, 2e-6, False),
        (-1.0, 1.0, 1e-5, False),
        (0.0, 0.0, 0.0, True),
        (0.0, 1e-9, 0.0, False),
        (math.inf, math.inf, math.inf, True),
        (1.0, math.nan, 1e9, False),
        (1.0, math.inf, 1e-6, False),
    ],
)
def test_a_figure_is_reproduced_within_its_tolerance(published, reproduced, within, is_reproduced):
    assert row("figure", "case", published, reproduced, "", within=within).is_surprising is not is_reproduced


def test_ratio():
    assert row("figure", "case", 2.0, 3.0, "").ratio == 1.5
    assert row("figure", "case", math.inf, math.inf, "").ratio == 1.0
    assert row("figure", "case", 0.0, 1.0, "").ratio is None


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
