"""Couplings of the settings and the state after a reset."""

from dataclasses import replace

import pytest

from analyzer_sim.instrument.settings.analyzer_model import AnalyzerModel
from analyzer_sim.instrument.settings.instrument_settings import Settings, reset_state
from analyzer_sim.instrument.settings.models import FSW_26, MS2090A, N9020B
from analyzer_sim.instrument.settings.quantities import store


def fresh(model: AnalyzerModel = FSW_26, **values: object) -> Settings:
    return replace(reset_state(model), **values)


def put(settings: Settings, **values: float) -> None:
    for name, value in values.items():
        store(settings, name, value)


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
