"""Settings: filter steps of the makes, limits, what storing does, couplings, the state after a reset."""

from dataclasses import replace

import pytest

from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.instrument.instrument_settings import Settings, reset_state
from analyzer_sim.instrument.models import FSW_26, MS2090A, N9020B, SSA3032X, AnalyzerModel, FilterSteps, decade_steps
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


def test_preset_sweeps_where_the_reset_does_not() -> None:
    assert not reset_state(N9020B).is_continuous
    assert reset_state(N9020B, is_preset=True).is_continuous
    assert reset_state(FSW_26).is_continuous


def test_hold_combines_only_when_several_sweeps_are_taken() -> None:
    assert fresh(hold="MAXH").combination == "POW"
    assert fresh(is_averaging=True, hold="MAXH").combination == "MAXH"
