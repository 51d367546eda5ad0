"""The paper method as a step over values: what a row changes, and what leaves the state alone."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic_payload as synthetic

from service.pipeline.config import ChainConfig
from service.pipeline.estimation.paper.method import initial_state, paper_model, step_paper
from service.pipeline.inputs.knowledge import Knowledge, update
from service.records.inputs import Operation
from service.records.levels.attitude import Status

CONFIG = ChainConfig()
TRUTH = (0.1, -0.15, 0.2)


class Bench:
    """A model on an exact payload, fed row by row."""

    def __init__(self, payload, synthetic):
        self.payload, self.minute, self.start_us = payload, synthetic.MINUTE, synthetic.START_US + synthetic.HOUR
        self.documents = synthetic.FixedDocuments(payload, self.start_us)
        self.knowledge = Knowledge()
        for content in synthetic.opening(payload.spacecraft()):
            self.knowledge = update(self.knowledge, content, self.documents)
        self.model = paper_model(self.knowledge, self.documents.calibration(1))
        self.state = initial_state(len(payload.ids), CONFIG)

    def step(self, minute, angles=TRUTH, *, common_db=0.0, is_late=False, is_catch_up=False, absent=()):
        measurement = self.payload.measurement(self.start_us + minute * self.minute, angles)
        power = measurement.power_dbm + common_db
        power[list(absent)] = np.nan
        found = step_paper(
            self.state,
            self.model,
            self.knowledge,
            self.payload.ephemeris(),
            measurement,
            power,
            is_late=is_late,
            is_catch_up=is_catch_up,
            config=CONFIG,
        )
        self.state = found.state
        return found

    def run(self, minutes, **options):
        return [self.step(minute, **options) for minute in minutes]


@pytest.fixture
def bench(payload):
    """An aligned method before its first row."""
    return Bench(payload, synthetic)


def test_no_model_without_calibration_ephemeris_or_alignment(bench):
    aligned_with = bench.documents.calibration(1)
    assert paper_model(replace(bench.knowledge, active={}), aligned_with) is None
    assert paper_model(replace(bench.knowledge, ephemeris=None), aligned_with) is None
    assert paper_model(replace(bench.knowledge, alignment=None), aligned_with) is None


def test_the_method_settles_and_then_tells_the_exact_attitude(bench):
    steps = bench.run(range(1, 32))
    rows = [step.row for step in steps]
    assert [row.inhibitions for row in rows[:7]] == [("settling", "no_fix")] * 7
    assert all(np.isnan(row.attitude_deg).all() and row.status is Status.INVALID for row in rows[:7])
    for row in rows[7:]:
        np.testing.assert_allclose(row.attitude_deg, TRUTH, atol=1e-9)  # exact payload, rounding
        assert (row.status, row.control_allowed, row.inhibitions) == (Status.ACQUIRED, True, ())
        assert row.carriers_used == 12
        assert row.residual_rms_db < 1e-9
    # a third of half an hour of fixes, the first in the eighth row
    assert [row.rates_deg_s is None for row in rows[:19]] == [True] * 17 + [False] * 2
    np.testing.assert_allclose(rows[-1].rates_deg_s, 0.0, atol=1e-12)
    assert np.isnan(rows[-1].common_db)
    assert (rows[-1].calibration_id, rows[-1].alignment_id) == (1, 1)


def test_a_steady_turn_lags_by_half_the_window_and_has_the_right_rate(bench):
    rate_deg_min = np.array([0.0, 1e-3, -1e-3])
    rows = [bench.step(minute, 0.2 * np.ones(3) + rate_deg_min * minute).row for minute in range(1, 61)]
    # mean of fifteen rows: seven minutes back; linear on one side of zero, so exact
    np.testing.assert_allclose(rows[-1].attitude_deg, 0.2 + rate_deg_min * 53, atol=1e-9)
    np.testing.assert_allclose(rows[-1].rates_deg_s, rate_deg_min / 60.0, atol=1e-12)


def test_a_late_row_gets_a_fix_of_its_own_and_leaves_the_state_bit_for_bit(bench):
    bench.run(range(1, 32))
    before = bench.state
    late = bench.step(12, (0.0, 0.3, 0.3), is_late=True)
    assert late.state is before
    np.testing.assert_allclose(late.row.attitude_deg, (0.0, 0.3, 0.3), atol=1e-9)
    assert late.row.inhibitions == ("late",)
    assert late.row.rates_deg_s is None
    assert not late.row.control_allowed


def test_a_late_row_does_not_need_a_settled_state(bench):
    late = bench.step(-5, is_late=True)
    assert late.row.inhibitions == ("late",)
    np.testing.assert_allclose(late.row.attitude_deg, TRUTH, atol=1e-9)


def test_catch_up_is_said_on_the_row_and_moves_the_state(bench):
    rows = bench.run(range(1, 20), is_catch_up=True)
    assert rows[-1].row.inhibitions == ("catch_up",)
    assert len(bench.state.fixes.epochs_us) == 12


def test_a_long_gap_empties_means_and_rates(bench):
    bench.run(range(1, 32))
    within = bench.step(31 + 30).row
    assert "settling" in within.inhibitions  # the mean reaches fifteen minutes back, the state stays
    assert len(bench.state.fixes.epochs_us) == 0 or bench.state.newest_us == bench.start_us + 61 * bench.minute
    bench.run(range(62, 80))
    after = bench.step(79 + 31).row
    assert after.inhibitions == ("settling", "no_fix")
    assert len(bench.state.window.epoch_us) == 1
    assert len(bench.state.fixes.epochs_us) == 0


def test_a_row_of_only_absent_powers_is_a_row(bench):
    bench.run(range(1, 20))
    row = bench.step(20, absent=range(12)).row
    np.testing.assert_allclose(row.attitude_deg, TRUTH, atol=1e-9)
    rows = [bench.step(minute, absent=range(12)).row for minute in range(21, 40)]
    # after eight of fifteen rows no carrier has the eight present ones that its mean needs
    assert rows[-1].inhibitions == ("no_fix",)
    assert np.isnan(rows[-1].residual_rms_db)
    assert rows[-1].carriers_used == 0
    assert {item.reason for item in rows[-1].excluded} == {"absent"}


def test_downlink_rain_stops_control_says_how_deep_and_clears_by_itself(bench):
    bench.run(range(1, 20), angles=(0.0, 0.0, 0.0))
    wet = [step.row for step in bench.run(range(20, 40), angles=(0.0, 0.0, 0.0), common_db=-2.0)]
    assert wet[-1].inhibitions[0] == "downlink_fade"
    assert wet[-1].downlink_fade
    assert wet[-1].downlink_fade_db == pytest.approx(2.0, abs=1e-9)  # a mean of wet minutes only
    first = next(k for k, row in enumerate(wet) if row.downlink_fade)
    # the rule has to stand for so long, and the short mean has to fall below the depth before
    mean_rows = int(CONFIG.fade.averaging_window_s / 60)
    entry_rows, exit_rows = int(CONFIG.fade.entry_s / 60), int(CONFIG.fade.exit_s / 60)
    assert entry_rows <= first + 1 <= entry_rows + mean_rows
    dry = [step.row for step in bench.run(range(40, 80), angles=(0.0, 0.0, 0.0))]
    back = next(k for k, row in enumerate(dry) if not row.downlink_fade)
    assert exit_rows <= back + 1 <= exit_rows + mean_rows
    assert dry[-1].inhibitions == ()
    assert dry[-1].downlink_fade_db == 0.0


def test_a_standing_fade_without_any_carrier_has_no_depth(bench):
    bench.run(range(1, 20), angles=(0.0, 0.0, 0.0))
    bench.run(range(20, 40), angles=(0.0, 0.0, 0.0), common_db=-2.0)
    row = [step.row for step in bench.run(range(40, 50), absent=range(12))][-1]
    assert row.downlink_fade
    assert row.downlink_fade_db == 0.0


def test_a_declared_operation_forbids_control_while_it_lasts(bench):
    bench.run(range(1, 20))
    start_us = bench.start_us + 25 * bench.minute
    operation = Operation(1, "eclipse", start_us, start_us + 2 * bench.minute, inhibit_control=True)
    bench.knowledge = update(bench.knowledge, operation, bench.documents)
    reasons = [step.row.inhibitions for step in bench.run(range(24, 29))]
    assert reasons == [(), ("operation",), ("operation",), (), ()]
