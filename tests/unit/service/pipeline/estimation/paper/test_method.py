"""The published method in the pipeline."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic_payload as synthetic
from paper_rows import expected_dbm, reject

from service.core.estimation.filtering.filter_model import FilterSettings
from service.core.estimation.noise import averaged_sigma_db
from service.core.estimation.paper.loop_observer import known_motion
from service.core.estimation.paper.row import LEVEL, RESULT, write_fix
from service.core.estimation.paper.snapshot import predict_deviation_db
from service.core.geometry.frames import AntennaDirection
from service.pipeline.checkpoints import RECORDS, Layout
from service.pipeline.config import ChainConfig
from service.pipeline.estimation.paper.paper_model import (
    ExpectedPower,
    expected_power,
    harmonic_arrays,
    harmonic_db,
    paper_arrays,
    paper_model,
    references_of,
    sensitivity_model,
)
from service.pipeline.estimation.paper.runner import SavedPaper, initial_state, take_rows
from service.pipeline.inputs.knowledge import Knowledge, update
from service.pipeline.inputs.known_motion import CommandedMotion, commanded_arrays, consume, heard
from service.records.calibration import CarrierReference, NoiseComponent
from service.records.catalogue import Method
from service.records.inputs import Correction, Operation
from service.records.levels.attitude import Axes, Exclusion, Pulse, ReportedCommand, Status

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
        self.plan = self.knowledge.plan
        self.model = paper_model(self.knowledge, self.plan, self.documents.calibration(1), CONFIG)
        self.state = initial_state(self.knowledge.alignment, self.model)

    def step(self, minute, angles=TRUTH, *, common_db=0.0, is_late=False, is_catch_up=False, absent=(), change_db=0.0):
        measurement = self.payload.measurement(self.start_us + minute * self.minute, angles)
        power = measurement.power_dbm + common_db + change_db
        power[list(absent)] = np.nan
        (found,), self.state = take_rows(
            self.state,
            self.model,
            self.knowledge,
            [measurement],
            power[None, :],
            is_late=is_late,
            is_catch_up=is_catch_up,
            config=CONFIG,
        )
        return found

    def run(self, minutes, **options):
        return [self.step(minute, **options) for minute in minutes]


@pytest.fixture
def bench(payload):
    """An aligned method before its first row."""
    return Bench(payload, synthetic)


def test_no_model_without_calibration_ephemeris_or_alignment(bench):
    aligned_with = bench.documents.calibration(1)
    assert paper_model(bench.knowledge._replace(active={}), bench.plan, aligned_with, CONFIG) is None
    assert paper_model(bench.knowledge._replace(ephemeris=None), bench.plan, aligned_with, CONFIG) is None
    assert paper_model(bench.knowledge._replace(alignment=None), bench.plan, aligned_with, CONFIG) is None


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
    # the loop knows a rate from the alignment on: nothing was commanded
    assert all(row.rates_deg_s is not None for row in rows)
    assert np.isnan(rows[-1].common_db)
    assert (rows[-1].calibration_id, rows[-1].alignment_id) == (1, 1)


def test_a_steady_turn_lags_by_half_the_window(bench):
    rate_deg_min = np.array([0.0, 1e-3, -1e-3])
    rows = [bench.step(minute, 0.2 * np.ones(3) + rate_deg_min * minute).row for minute in range(1, 61)]
    # mean of fifteen rows: seven minutes back; linear on one side of zero, so exact
    np.testing.assert_allclose(rows[-1].attitude_deg, 0.2 + rate_deg_min * 53, atol=1e-9)


def test_a_late_row_gets_a_fix_of_its_own_and_leaves_the_state_bit_for_bit(bench):
    bench.run(range(1, 32))
    before = bench.state
    late = bench.step(12, (0.0, 0.3, 0.3), is_late=True)
    assert bench.state is before
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


def test_a_long_gap_empties_means(bench):
    bench.run(range(1, 32))
    within = bench.step(31 + 30).row
    assert "settling" in within.inhibitions  # the mean reaches fifteen minutes back, the state stays
    assert bench.state.arrays.counters["newest_us"][0] == bench.start_us + 61 * bench.minute
    bench.run(range(62, 80))
    after = bench.step(79 + 31).row
    assert after.inhibitions == ("settling", "no_fix")
    assert len(bench.state.arrays.window_us) == len(bench.state.arrays.window_db) == 1


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
    assert first < 3
    mean_rows, exit_rows = int(CONFIG.fade.averaging_window_s / 60), int(CONFIG.fade.exit_s / 60)
    dry = [step.row for step in bench.run(range(40, 80), angles=(0.0, 0.0, 0.0))]
    back = next(k for k, row in enumerate(dry) if not row.downlink_fade)
    assert exit_rows <= back + 1 <= exit_rows + mean_rows
    assert dry[-1].inhibitions == ()
    assert dry[-1].downlink_fade_db == 0.0


@pytest.mark.parametrize(("rise_db", "within_rows"), [(0.5, 5), (1.5, 3)])
def test_a_rise_of_all_levels_stops_control_and_gives_no_angles(bench, rise_db, within_rows):
    bench.run(range(1, 20), angles=(0.0, 0.0, 0.0))
    risen = [step.row for step in bench.run(range(20, 50), angles=(0.0, 0.0, 0.0), common_db=rise_db)]
    stopped = next(k for k, row in enumerate(risen) if "common_change" in row.inhibitions)
    assert stopped < within_rows
    assert all(row.status is Status.INVALID and not row.control_allowed for row in risen[stopped:])
    # what was measured of it never reached the angles that control steers by
    np.testing.assert_allclose([row.steering_deg for row in risen], 0.0, atol=1e-3)
    dry = [step.row for step in bench.run(range(50, 90), angles=(0.0, 0.0, 0.0))]
    assert dry[-1].inhibitions == ()


def test_a_fade_leaves_no_trace_in_what_control_steers_by(bench):
    still = {"angles": (0.0, 0.0, 0.0)}
    bench.run(range(1, 60), **still)
    rows = [step.row for step in bench.run(range(60, 100), common_db=-2.0, **still)]
    rows += [step.row for step in bench.run(range(100, 140), **still)]
    # the fixes are led astray, the angles and rates of the loop are not
    assert np.abs(np.array([row.attitude_deg for row in rows])[:, 1:]).max() > 0.2
    np.testing.assert_allclose([row.steering_deg for row in rows], 0.0, atol=1e-3)
    np.testing.assert_allclose([row.rates_deg_s for row in rows], 0.0, atol=1e-6)


def test_every_axis_is_steered(bench):
    assert [step.row.control_allowed_axes for step in bench.run(range(1, 32))][-1] == (True, True, True)


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


def test_a_state_is_never_changed_and_holds_no_row_of_the_caller(bench):
    bench.run(range(1, 20))
    before = [each.copy() for each in bench.state.arrays]
    state = bench.state
    bench.step(20)
    for each, then in zip(state.arrays, before, strict=True):
        np.testing.assert_array_equal(each, then)


def test_a_state_goes_on_from_its_bytes_bit_for_bit_and_as_fast(bench):
    bench.run(range(1, 20))
    layout, state = Layout(SavedPaper, RECORDS), bench.state
    bench.run(range(20, 25))
    ahead = bench.state
    bench.state = layout.unpack(layout.pack(SavedPaper(state, None, None)), SavedPaper).state
    bench.run(range(20, 25))
    for each, other in zip(bench.state.arrays, ahead.arrays, strict=True):
        assert each.tobytes() == other.tobytes()
        assert each.dtype.isalignedstruct == other.dtype.isalignedstruct


def test_the_window_forgets_what_no_mean_reaches(bench):
    bench.run(range(1, 40))
    state = bench.state.arrays
    assert state.window_us.tolist() == [bench.start_us + minute * bench.minute for minute in range(25, 40)]
    assert state.window_db.shape == (15, 12)


def test_a_row_that_is_not_newer_leaves_the_window_bit_for_bit(bench):
    bench.run(range(1, 20))
    before = bench.state.arrays.window_us.tobytes(), bench.state.arrays.window_db.tobytes()
    bench.step(19, (0.0, 0.0, 0.0))
    assert (bench.state.arrays.window_us.tobytes(), bench.state.arrays.window_db.tobytes()) == before


def test_what_was_commanded_is_that_of_the_robust_method(bench):
    """Corrections and pulses, some late, over steps that cut them."""
    record, start_us, minute = bench.payload.spacecraft(), bench.start_us, bench.minute
    commanded, at_us = CommandedMotion(start_us), start_us + 3 * minute
    changes = (
        Correction(start_us - 2 * minute, start_us + 9 * minute, Axes(0.3, -0.2, 0.1)),
        Correction(start_us + minute, start_us + 2 * minute, Axes(0.1, 0.2, 0.3)),
        ReportedCommand(1, at_us, (Pulse(start_us + 5 * minute, 90.0, Axes(0.1, -0.1, 0.2)),)),
    )
    for change in changes:
        commanded = heard(commanded, change, record, at_us)
    for to_us in (start_us + 4 * minute, start_us + 5 * minute + 1, start_us + 6 * minute, start_us + 20 * minute):
        found = known_motion(commanded_arrays(commanded, to_us), at_us, to_us)
        known, commanded = consume(commanded, at_us, to_us)
        expected = known.correction_deg, known.late_correction_deg, known.rate_change_deg_h
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)
        at_us = to_us


ANGLES = np.array([0.2, -0.15, 0.1])


@pytest.fixture
def model(payload):
    """The payload's true model."""
    return sensitivity_model(payload.calibration())


@pytest.fixture
def deviation(payload):
    """Deviations at the angles of this file."""
    return predict_deviation_db(payload.plus, payload.minus, ANGLES)


def arrays_of(model):
    """Return a model without references."""
    nothing = np.zeros(len(model.carrier_ids))
    expected = ExpectedPower(model.carrier_ids, nothing, nothing, nothing)
    return paper_arrays(expected, model, AntennaDirection(nothing, nothing + 8.0), FilterSettings(), CONFIG)


def solve(model, deviation_db, rows=15, span_s=840.0):
    """Return what a mean of some rows leaves, and that of each carrier."""
    arrays, levels, result = arrays_of(model), np.zeros(len(deviation_db), LEVEL), np.zeros(1, RESULT)
    considered_db = np.where(model.is_selected, deviation_db, np.nan)
    outcome = reject(model.plus_db_per_deg, model.minus_db_per_deg, considered_db)
    write_fix(arrays, outcome, considered_db, rows, span_s, levels, result)
    return result[0], levels


def test_the_model_holds_the_figures_of_the_calibration(payload, model):
    np.testing.assert_array_equal(model.plus_db_per_deg, payload.plus)
    np.testing.assert_array_equal(model.minus_db_per_deg, payload.minus)
    assert model.carrier_ids == payload.ids
    assert model.is_selected.all()
    # carriers without a coloured part have a zero there, not a hole
    np.testing.assert_array_equal(model.sigma_coloured_db[:, 0], np.tile([0.0, 0.02], 6))
    np.testing.assert_array_equal(model.correlation_time_s[:, 0], np.tile([0.0, 1200.0], 6))


def test_an_unfinished_calibration_is_an_empty_model(payload):
    empty = sensitivity_model(replace(payload.calibration(), result=None))
    assert empty.plus_db_per_deg.shape == (0, 3)
    assert solve(empty, np.zeros(0))[0]["carriers_used"] == 0


def test_a_carrier_in_uplink_rain_is_left_out_with_its_reason(bench):
    step = bench.step(5, ANGLES, change_db=-4.0 * (np.arange(12) == 3), is_late=True)
    np.testing.assert_allclose(step.row.attitude_deg, ANGLES, atol=1e-9)
    assert (step.row.carriers_used, step.row.excluded) == (11, (Exclusion("c03", "uplink_fade"),))
    assert step.levels["residual_db"][3] == pytest.approx(-4.0, abs=1e-9)


def with_carrier(payload, number, **changes):
    """Return a payload whose calibration says something else of one carrier."""
    calibration = payload.calibration()
    carriers = list(calibration.result.carriers)
    carriers[number] = replace(carriers[number], **changes)
    made = replace(calibration, result=replace(calibration.result, carriers=tuple(carriers)))
    return type(
        "Changed", (), {"calibration": lambda *_, **__: made, "__getattr__": lambda _, name: getattr(payload, name)}
    )()


def test_unselected_carriers_neither_enter_nor_count_as_excluded(payload):
    bench = Bench(with_carrier(payload, 0, selected=False), synthetic)
    row = bench.step(5, ANGLES, change_db=50.0 * (np.arange(12) == 0), is_late=True).row
    np.testing.assert_allclose(row.attitude_deg, ANGLES, atol=1e-9)
    assert (row.carriers_used, row.excluded) == (11, ())


def test_absent_levels_and_coefficients_are_not_counted_as_used(payload):
    bench = Bench(with_carrier(payload, 1, sensitivity_minus_db_per_deg=Axes(float("nan"), 1.0, 1.0)), synthetic)
    row = bench.step(5, ANGLES, absent=(0,), is_late=True).row
    assert row.carriers_used == 10
    assert row.excluded == (Exclusion("c00", "absent"), Exclusion("c01", "absent"))


@pytest.mark.parametrize("present", [0, 3])
def test_too_few_carriers_give_no_fix_and_no_exception(bench, present):
    row = bench.step(5, absent=range(present, 12), is_late=True).row
    assert np.isnan(row.attitude_deg).all()
    assert np.isnan(row.sigma_deg).all()
    assert row.carriers_used == present
    assert len(row.excluded) == 12 - present


def test_the_sigma_is_never_better_than_the_learned_noise_allows(payload, model, deviation):
    """Residuals that agree by chance do not shrink it: then the learned noise of the mean holds."""
    rng = np.random.default_rng(11)
    fix, levels = solve(model, 1e-4 * rng.normal(size=12))
    slopes = np.where(fix["attitude_deg"] >= 0.0, payload.plus, payload.minus)
    identified = np.sqrt(np.mean(levels["sigma_db"] ** 2) * np.diag(np.linalg.inv(slopes.T @ slopes)))
    np.testing.assert_allclose(fix["sigma_deg"], identified, rtol=1e-5)  # 1e-4 dB in common
    rough, _ = solve(model, deviation + 0.3 * rng.normal(size=12))
    assert (rough["sigma_deg"] > 2.0 * fix["sigma_deg"]).all()


def test_residuals_of_the_carriers_scale_the_sigma(model, deviation):
    noise_db = 0.5 * np.random.default_rng(12).normal(size=12)
    one, other = (solve(model, deviation + factor * noise_db)[0] for factor in (0.5, 1.0))
    assert (one["sigma_deg"] < other["sigma_deg"]).all()


def test_the_sigma_covers_a_fade_that_is_too_shallow_to_be_found(model, deviation):
    faded, _ = solve(model, deviation - 0.35)
    assert (np.abs(faded["attitude_deg"] - ANGLES)[1:] > 0.05).any()
    still, _ = solve(model, np.full(12, -0.35))
    np.testing.assert_array_less(np.abs(still["attitude_deg"]), 1.05 * still["sigma_deg"] + 1e-9)


def test_a_sigma_that_is_not_known_does_not_hide_those_that_are(model):
    rng = np.random.default_rng(12)
    noisy = 1e-4 * rng.normal(size=12)
    holed = replace(model, sigma_white_db=np.where(np.arange(12) == 4, np.nan, model.sigma_white_db))
    whole = solve(model, noisy)[0]["sigma_deg"] ** 2
    # one of twelve like carriers less in the mean of the learned variances: at most 12 % either way
    np.testing.assert_allclose(solve(holed, noisy)[0]["sigma_deg"] ** 2, whole, rtol=0.12)
    unknown = replace(model, sigma_white_db=np.full(12, np.nan))
    assert (solve(unknown, noisy)[0]["sigma_deg"] ** 2 < 0.01 * whole).all()


def test_perfect_agreement_is_no_division_by_zero(model):
    fix, _ = solve(model, np.zeros(12))
    np.testing.assert_array_equal(fix["attitude_deg"], 0.0)
    assert np.isfinite(fix["sigma_deg"]).all()


def test_all_coloured_parts_of_a_carrier_count(payload, deviation):
    calibration = payload.calibration(noise=(NoiseComponent(300.0, 0.06), NoiseComponent(7200.0, 0.08)))
    model = sensitivity_model(calibration)
    assert model.sigma_coloured_db.shape == (12, 2)
    sigma_db = solve(model, deviation)[1]["sigma_db"]
    # a mean of 14 minutes keeps nearly all of the slow part and half of the fast one
    assert (sigma_db > 0.08).all()
    assert (sigma_db < np.sqrt(0.05**2 / 15 + 0.06**2 + 0.08**2)).all()
    noise = model.sigma_white_db, model.sigma_coloured_db, model.correlation_time_s
    for rows, span_s in ((15, 840.0), (1, 0.0), (2, 0.1)):
        expected = averaged_sigma_db(*noise, rows=rows, span_s=span_s)
        np.testing.assert_allclose(solve(model, deviation, rows, span_s)[1]["sigma_db"], expected, rtol=1e-12)


@pytest.fixture
def at_us():
    """Instants over two nodal periods."""
    return synthetic.START_US + np.arange(0, 2 * synthetic.DAY, synthetic.DAY // 7)


def test_at_the_reference_attitude_nothing_is_left_at_any_phase(payload, at_us):
    alignment = payload.alignment(synthetic.START_US)
    calibration, ephemeris = payload.calibration(), payload.ephemeris()
    expected = expected_power(calibration, alignment, Method.PAPER, ephemeris, calibration)
    powers = payload.power_dbm(at_us, np.zeros(3))
    for epoch_us, power in zip(at_us.tolist(), powers, strict=True):
        # rounding of sums of 50 dBm
        np.testing.assert_allclose(expected_dbm(epoch_us, expected, ephemeris), power, atol=1e-12)


def test_the_deviation_is_what_the_harmonic_leaves(bench, at_us):
    calibration, ephemeris = bench.payload.calibration(), bench.payload.ephemeris()
    expected = expected_power(calibration, bench.knowledge.alignment, Method.PAPER, ephemeris, calibration)
    for minute in (1, 500, 1200):
        levels = bench.step(minute, np.zeros(3), absent=(2,), is_late=True).levels
        epoch_us = bench.start_us + minute * bench.minute
        np.testing.assert_allclose(levels["expected_dbm"], expected_dbm(epoch_us, expected, ephemeris), atol=1e-12)
        assert np.flatnonzero(np.isnan(levels["deviation_db"])).tolist() == [2]
        np.testing.assert_allclose(np.delete(levels["deviation_db"], 2), 0.0, atol=1e-12)


def test_carriers_without_reference_have_no_deviation(payload):
    alignment = payload.alignment(synthetic.START_US)
    alignment = replace(alignment, references=alignment.references[1:])
    calibration, ephemeris = payload.calibration(), payload.ephemeris()
    expected = expected_power(calibration, alignment, Method.PAPER, ephemeris, calibration)
    found = expected_dbm(synthetic.START_US, expected, ephemeris)
    assert np.flatnonzero(np.isnan(found)).tolist() == [0]


def test_harmonics_of_a_calibration_are_those_of_its_carriers(payload, at_us):
    amplitude, phase = harmonic_arrays(payload.calibration())
    np.testing.assert_array_equal(amplitude, payload.amplitude_db)
    np.testing.assert_array_equal(phase, payload.phase_rad)
    found = harmonic_db(payload.calibration(), payload.ephemeris(), at_us)
    # the same cosine, rounding only
    np.testing.assert_allclose(found, payload.harmonic_db(at_us), atol=1e-12)


def test_an_unfinished_calibration_has_no_harmonics(payload):
    amplitude, phase = harmonic_arrays(replace(payload.calibration(), result=None))
    assert (amplitude.size, phase.size) == (0, 0)


def test_a_new_calibration_keeps_the_mean_power_of_the_alignment_window(payload):
    old, alignment = payload.calibration(1), payload.alignment(synthetic.START_US + 5 * synthetic.HOUR)
    turned = replace(payload, amplitude_db=2.0 * payload.amplitude_db, phase_rad=payload.phase_rad + 1.0)
    new = turned.calibration(2)
    moved = expected_power(new, alignment, Method.PAPER, payload.ephemeris(), old)
    window_us = np.linspace(alignment.window.start_us, alignment.window.stop_us, 400)
    before = payload.level_dbm + harmonic_db(old, payload.ephemeris(), window_us).mean(axis=0)
    after = moved.reference_dbm + harmonic_db(new, payload.ephemeris(), window_us).mean(axis=0)
    # sixty instants against four hundred over a quarter of an hour of a daily wave
    np.testing.assert_allclose(after, before, atol=1e-4)
    assert np.abs(moved.reference_dbm - payload.level_dbm).max() > 0.05


def test_a_new_calibration_moves_references_by_the_change_at_the_angles_of_the_alignment(payload):
    old, angles = payload.calibration(1), np.array([0.2, -0.15, 0.2])
    new = replace(payload, plus=1.3 * payload.plus, minus=1.3 * payload.minus).calibration(2)
    made = payload.alignment(synthetic.START_US + synthetic.HOUR)
    alignment = replace(made, attitude_deg=Axes(*angles))
    moved = expected_power(new, alignment, Method.PAPER, payload.ephemeris(), old)
    change_db = predict_deviation_db(payload.plus, payload.minus, angles)
    # the power in the window is the same, and 1.3 times the change belongs to its angles now
    np.testing.assert_allclose(moved.reference_dbm - payload.level_dbm, -0.3 * change_db, atol=1e-12)


def test_a_carrier_that_the_former_calibration_did_not_have_gets_no_reference(payload):
    old = payload.calibration(1)
    old = replace(old, result=replace(old.result, carriers=old.result.carriers[1:]))
    alignment = payload.alignment(synthetic.START_US + synthetic.HOUR)
    found = expected_power(payload.calibration(2), alignment, Method.PAPER, payload.ephemeris(), old)
    assert np.flatnonzero(np.isnan(found.reference_dbm)).tolist() == [0]


def test_a_former_calibration_without_result_gives_no_reference_at_all(payload):
    old = replace(payload.calibration(1), result=None)
    alignment = payload.alignment(synthetic.START_US + synthetic.HOUR)
    found = expected_power(payload.calibration(2), alignment, Method.PAPER, payload.ephemeris(), old)
    assert np.isnan(found.reference_dbm).all()


def test_without_a_window_references_stay_as_they_are(payload):
    alignment = replace(payload.alignment(synthetic.START_US), window=None)
    found = expected_power(payload.calibration(2), alignment, Method.PAPER, payload.ephemeris(), payload.calibration(1))
    np.testing.assert_array_equal(found.reference_dbm, payload.level_dbm)


def test_an_unfinished_calibration_expects_nothing(payload):
    empty = replace(payload.calibration(1), result=None)
    found = expected_power(empty, payload.alignment(synthetic.START_US), Method.PAPER, payload.ephemeris(), empty)
    assert (found.carrier_ids, found.reference_dbm.size) == ((), 0)


def test_a_method_may_have_references_of_its_own(payload):
    own = (CarrierReference("c00", -1.0, 0.1, 9, 0.0),)
    alignment = replace(payload.alignment(synthetic.START_US), references_by_method={"robust": own})
    assert references_of(alignment, Method.ROBUST) == own
    assert references_of(alignment, Method.PAPER) == alignment.references
