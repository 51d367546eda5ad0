"""Settings: filter steps of the makes, limits, couplings, the state after a reset; errors of the instrument itself."""

from dataclasses import replace

import numpy as np
import pytest

from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.instrument.imperfections import IDEAL, Imperfections, LevelErrors
from analyzer_sim.instrument.instrument_settings import (
    FSW_26,
    MS2090A,
    SSA3032X,
    AnalyzerModel,
    FilterSteps,
    Settings,
    decade_steps,
    reset_state,
)
from analyzer_sim.instrument.quantities import QUANTITIES, load, shown_limits, store

MODELS = {name: dialect.model for name, dialect in DIALECTS.items()}


def fresh(model: AnalyzerModel = FSW_26, **values: object) -> Settings:
    return replace(reset_state(model), **values)


def put(settings: Settings, **values: float) -> None:
    for name, value in values.items():
        store(settings, name, value)


def test_centre_keeps_the_span_and_span_keeps_the_centre() -> None:
    settings = fresh()
    put(settings, span_hz=20e6, center_hz=1017e6)
    assert (settings.start_hz, settings.stop_hz) == (1007e6, 1027e6)
    put(settings, span_hz=36e6)
    assert (settings.start_hz, settings.stop_hz) == (999e6, 1035e6)


def test_start_and_stop_push_each_other() -> None:
    settings = fresh()
    put(settings, start_hz=954e6, stop_hz=990e6)
    assert (load(settings, "center_hz"), load(settings, "span_hz")) == (972e6, 36e6)
    put(settings, start_hz=1000e6)
    assert settings.stop_hz > settings.start_hz
    put(settings, stop_hz=500e6)
    assert settings.start_hz < settings.stop_hz


def test_centre_at_the_edge_of_the_band_narrows_the_span() -> None:
    settings = fresh()
    put(settings, span_hz=100e6, center_hz=10e6)
    assert (settings.start_hz, settings.stop_hz) == (0.0, 20e6)


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("name", QUANTITIES)
def test_setting_is_clamped_to_its_limits(name: str, model: AnalyzerModel) -> None:
    settings = fresh(replace(model, are_points_fixed=False))
    put(settings, start_hz=954e6, stop_hz=990e6)
    limits = shown_limits(settings, name)
    for wanted, expected in ((limits.high * 10 + 1e13, limits.high), (limits.low - 1e13, limits.low)):
        assert store(settings, name, wanted)
        assert load(settings, name) == pytest.approx(expected, rel=1e-12)  # 12 digits are shown
        assert not store(settings, name, expected)


def test_fixed_points_take_any_value_and_keep_their_own() -> None:
    settings = fresh(SSA3032X)
    assert not store(settings, "points", 2401)
    assert load(settings, "points") == 751


def test_frequency_offset_moves_what_is_shown_and_not_what_is_swept() -> None:
    settings = fresh()
    put(settings, start_hz=954e6, stop_hz=990e6, offset_hz=10e9)
    assert settings.start_hz == 954e6
    assert load(settings, "start_hz") == 10.954e9
    put(settings, center_hz=10.96e9)
    assert settings.center_hz == 960e6
    assert shown_limits(settings, "stop_hz").high == FSW_26.max_frequency_hz + 10e9


def test_level_offset_moves_the_reference_level_shown_and_its_limits() -> None:
    settings = fresh()
    put(settings, reference_dbm=-20.0, level_offset_db=30.0)
    assert load(settings, "reference_dbm") == 10.0
    assert shown_limits(settings, "reference_dbm") == (-100.0, 60.0, 30.0)
    put(settings, reference_dbm=0.0)
    assert settings.reference_dbm == -30.0


def test_step_of_the_centre_is_a_tenth_of_the_span_until_it_is_chosen() -> None:
    settings = fresh()
    put(settings, span_hz=20e6)
    assert QUANTITIES["center_hz"].step(settings, 1) == 2e6
    put(settings, step_hz=5e6)
    assert QUANTITIES["center_hz"].step(settings, -1) == -5e6


@pytest.mark.parametrize(("wanted", "step"), [(29e3, 30e3), (24e3, 20e3), (25e3, 30e3), (8e6, 1e7), (0.2, 1.0)])
def test_filter_takes_the_nearest_step_on_a_logarithmic_scale(wanted: float, step: float) -> None:
    assert FSW_26.rbw.legal(wanted) == step


@pytest.mark.parametrize(("wanted", "step"), [(29e3, 30e3), (60e3, 30e3), (65e3, 100e3), (9e6, 1e6), (0.2, 1.0)])
def test_linear_filter_takes_the_nearest_step_and_rounds_up(wanted: float, step: float) -> None:
    assert SSA3032X.rbw.legal(wanted) == step


@pytest.mark.parametrize("steps", [model.rbw for model in MODELS.values()], ids=MODELS)
def test_up_and_down_walk_through_every_filter(steps: FilterSteps) -> None:
    walked = [steps.steps_hz[0]]
    while (wider := steps.neighbour(walked[-1], 1)) != walked[-1]:
        assert steps.neighbour(wider, -1) == walked[-1]
        walked.append(wider)
    assert tuple(walked) == steps.steps_hz
    assert list(walked) == sorted(set(walked))


def test_steps_of_decades_begin_and_end_at_the_bandwidths_given() -> None:
    assert decade_steps((1, 2, 5), 0.2, 20.0) == (0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


def test_filters_and_time_follow_the_span_when_coupled() -> None:
    settings = fresh(detector="RMS")
    put(settings, start_hz=954e6, stop_hz=990e6)
    assert settings.rbw_hz == 300e3  # 36 MHz / 100, nearest step
    assert settings.vbw_hz == settings.rbw_hz
    assert settings.time_s == pytest.approx(max(1e-3, 2.5 * 36e6 / 300e3**2), rel=1e-12)
    put(settings, rbw_hz=30e3)
    assert settings.time_s == pytest.approx(2.5 * 36e6 / 30e3**2, rel=1e-12)
    assert settings.vbw_hz == 30e3


def test_narrow_video_filter_slows_the_coupled_sweep_unless_the_detector_is_rms() -> None:
    settings = fresh(detector="SAMP")
    put(settings, start_hz=954e6, stop_hz=990e6, rbw_hz=30e3, vbw_hz=3e3)
    assert settings.time_s == pytest.approx(10 * 2.5 * 36e6 / 30e3**2, rel=1e-12)
    settings.detector = "RMS"
    assert settings.time_s == pytest.approx(2.5 * 36e6 / 30e3**2, rel=1e-12)


def test_too_fast_sweep_is_uncalibrated() -> None:
    settings = fresh()
    put(settings, start_hz=954e6, stop_hz=990e6, rbw_hz=30e3, time_s=0.2)
    assert not settings.is_uncalibrated
    put(settings, time_s=0.05)
    assert settings.is_uncalibrated


def test_attenuator_follows_the_reference_level_when_coupled() -> None:
    settings = fresh()
    assert settings.attenuation_db == 10.0
    put(settings, reference_dbm=-30.0)
    assert settings.attenuation_db == 0.0
    put(settings, attenuation_db=5.2)
    assert settings.attenuation_db == 5.0


def test_zero_span_keeps_the_filter() -> None:
    settings = fresh()
    put(settings, span_hz=10e6)
    before_hz = settings.rbw_hz
    put(settings, span_hz=0.0)
    assert (settings.span_hz, settings.rbw_hz) == (0.0, before_hz)


def test_count_of_sweeps_and_how_they_are_combined() -> None:
    assert fresh().sweeps == 1
    assert fresh(count=10).sweeps == 10
    assert fresh(average_count=5).sweeps == 1
    assert fresh(average_count=5, is_averaging=True).sweeps == 5
    assert fresh(count=10).combination == "POW"
    assert fresh(count=10, is_averaging=True).combination == "VID"


def test_ratios_of_the_couplings_are_those_of_the_model_until_they_are_chosen() -> None:
    settings = fresh(MS2090A)
    put(settings, span_hz=30e6)
    assert (settings.rbw_hz, settings.vbw_hz) == (100e3, 30e3)  # 30 MHz / 300, a third of it
    put(settings, rbw_per_span=0.01, vbw_per_rbw=1.0)
    assert (settings.rbw_hz, settings.vbw_hz) == (300e3, 300e3)


def test_filter_told_by_another_width_is_narrower_at_3_db() -> None:
    settings = fresh(filter_ratio=1.5)
    put(settings, rbw_hz=30e3)
    assert (settings.rbw_shown_hz, settings.rbw_hz) == (30e3, 20e3)


def test_hold_combines_only_when_several_sweeps_are_taken() -> None:
    assert fresh(hold="MAXH").combination == "POW"
    assert fresh(is_averaging=True, hold="MAXH").combination == "MAXH"


HOUR_US = 3_600_000_000


def errors_db(figures: Imperfections, seed: int, count: int = 2000, step_us: int = 60_000_000) -> np.ndarray:
    errors = LevelErrors(figures, seed)
    return np.array([errors.sweep_error_db(k * step_us, 30e3, 0.0) for k in range(count)])


def test_default_instrument_scatters_by_nine_hundredths_of_a_decibel_over_a_day_and_two_from_sweep_to_sweep() -> None:
    series = [errors_db(Imperfections(), seed, 1440) for seed in range(8)]
    # wander .05, day .1 / sqrt(2), repeatability .02; a day holds some twelve independent gain values
    assert np.mean([one.std() for one in series]) == pytest.approx(0.087, abs=0.008)
    steps = [np.diff(one).std() / np.sqrt(2.0) for one in series]
    assert np.mean(steps) == pytest.approx(0.021, abs=0.002)  # repeatability .02 and a minute of wander .006


def test_absolute_offset_is_drawn_once_per_instrument() -> None:
    figures = Imperfections(repeatability_sigma_db=0, wander_sigma_db=0, daily_swing_deg_c=0, rbw_switching_sigma_db=0,
                            attenuator_sigma_db=0)  # fmt: skip
    offsets = [errors_db(figures, seed, 3) for seed in range(200)]
    assert all(np.ptp(offset) == 0.0 for offset in offsets)
    assert np.std([offset[0] for offset in offsets]) == pytest.approx(0.25, rel=0.15)  # 200 draws: 5 % each sigma


def test_ideal_instrument_has_no_error() -> None:
    assert np.all(errors_db(IDEAL, 1, 10) == 0.0)
    assert np.all(LevelErrors(IDEAL, 1).ripple_db(np.linspace(0, 1e9, 100)) == 0.0)


def test_gain_wanders_with_its_correlation_time_and_stands_while_the_clock_stands() -> None:
    figures = Imperfections(absolute_sigma_db=0, repeatability_sigma_db=0, daily_swing_deg_c=0,
                            rbw_switching_sigma_db=0, attenuator_sigma_db=0, wander_sigma_db=0.05)  # fmt: skip
    series = errors_db(figures, 3, 20000, HOUR_US // 4)
    assert series.std() == pytest.approx(0.05, rel=0.1)  # 5000 correlation times
    lag_hour = np.corrcoef(series[4:], series[:-4])[0, 1]
    assert lag_hour == pytest.approx(np.exp(-1.0), abs=0.05)
    assert np.ptp(errors_db(figures, 3, 10, 0)) == 0.0


def test_switch_positions_err_alike_every_time() -> None:
    figures = Imperfections(absolute_sigma_db=0, repeatability_sigma_db=0, daily_swing_deg_c=0, wander_sigma_db=0)
    errors = LevelErrors(figures, 5)
    first = [errors.sweep_error_db(0, rbw_hz, att_db) for rbw_hz in (1e4, 3e4) for att_db in (0.0, 10.0)]
    again = [errors.sweep_error_db(0, rbw_hz, att_db) for rbw_hz in (1e4, 3e4) for att_db in (0.0, 10.0)]
    assert first == again
    assert len(set(first)) == 4


def test_room_changes_the_level_by_its_coefficient() -> None:
    figures = replace(IDEAL, temperature_db_per_deg_c=-0.02, daily_swing_deg_c=5.0)
    day = errors_db(figures, 1, 24, HOUR_US)
    np.testing.assert_allclose(day, -0.1 * np.sin(2 * np.pi * np.arange(24) / 24), atol=1e-12)  # -.02 dB by 5 deg C


def test_switches_stay_inside_the_bounds_of_the_data_sheet() -> None:
    figures = replace(IDEAL, rbw_switching_sigma_db=0.05, attenuator_sigma_db=0.1)
    errors = LevelErrors(figures, 5)
    filters = [errors.sweep_error_db(0, float(width), 0.0) for width in range(1, 400)]
    steps = [errors.sweep_error_db(0, 1.0, float(step)) for step in range(400)]
    assert np.ptp(filters) <= 0.2 + 1e-12  # +-0.10 dB
    assert np.ptp(steps) <= 0.4 + 1e-12  # +-0.2 dB
    assert np.std(filters) == pytest.approx(0.044, rel=0.15)  # a normal variable cut at two sigmas
    assert np.std(steps) == pytest.approx(0.088, rel=0.15)


def test_ripple_is_static_and_of_its_size() -> None:
    axis_hz = np.linspace(0.5e9, 2.5e9, 20001)
    figures = replace(IDEAL, ripple_sigma_db=0.05)
    ripple_db = LevelErrors(figures, 2).ripple_db(axis_hz)
    assert ripple_db.std() == pytest.approx(0.05, rel=0.05)  # many periods of each wave
    assert np.array_equal(ripple_db, LevelErrors(figures, 2).ripple_db(axis_hz))


def test_flatness_stays_inside_its_bound_and_moves_little_over_a_transponder() -> None:
    axis_hz = np.linspace(0.0, 26.5e9, 100001)
    spans = []
    for seed in range(20):
        flatness_db = LevelErrors(replace(IDEAL, flatness_bound_db=0.3), seed).ripple_db(axis_hz)
        assert np.abs(flatness_db).max() <= 0.3
        spans.append(np.abs(flatness_db).max())
        transponder_db = LevelErrors(replace(IDEAL, flatness_bound_db=0.3), seed).ripple_db(np.array([950e6, 986e6]))
        assert abs(np.diff(transponder_db)[0]) <= 0.0315  # steepest slopes of the three waves, 36 MHz
    assert np.mean(spans) > 0.25


@pytest.mark.parametrize(
    ("attenuation_db", "is_on", "expected"), [(0.0, False, -150), (10, False, -140), (0, True, -165)]
)
def test_attenuator_raises_and_preamplifier_lowers_the_own_noise(
    attenuation_db: float, is_on: bool, expected: float
) -> None:
    errors = LevelErrors(Imperfections(), 1)
    assert errors.own_noise_dbm_hz(attenuation_db, is_preamplifier_on=is_on) == expected
