"""Limits and couplings of the settings."""

import pytest

from analyzer_sim.instrument_settings import (
    FILTER_STEPS_HZ,
    MAX_FREQUENCY_HZ,
    QUANTITIES,
    Settings,
    load,
    nearest_step,
    shown_limits,
    store,
)


def put(settings: Settings, **values: float) -> None:
    for name, value in values.items():
        store(settings, name, value)


def test_centre_keeps_the_span_and_span_keeps_the_centre() -> None:
    settings = Settings()
    put(settings, span_hz=20e6, center_hz=1017e6)
    assert (settings.start_hz, settings.stop_hz) == (1007e6, 1027e6)
    put(settings, span_hz=36e6)
    assert (settings.start_hz, settings.stop_hz) == (999e6, 1035e6)


def test_start_and_stop_push_each_other() -> None:
    settings = Settings()
    put(settings, start_hz=954e6, stop_hz=990e6)
    assert (load(settings, "center_hz"), load(settings, "span_hz")) == (972e6, 36e6)
    put(settings, start_hz=1000e6)
    assert settings.stop_hz > settings.start_hz
    put(settings, stop_hz=500e6)
    assert settings.start_hz < settings.stop_hz


def test_centre_at_the_edge_of_the_band_narrows_the_span() -> None:
    settings = Settings()
    put(settings, span_hz=100e6, center_hz=10e6)
    assert (settings.start_hz, settings.stop_hz) == (0.0, 20e6)


@pytest.mark.parametrize("name", QUANTITIES)
def test_setting_is_clamped_to_its_limits(name: str) -> None:
    settings = Settings()
    put(settings, start_hz=954e6, stop_hz=990e6)
    limits = shown_limits(settings, name)
    for wanted, expected in ((limits.high * 10 + 1e13, limits.high), (limits.low - 1e13, limits.low)):
        assert store(settings, name, wanted)
        assert load(settings, name) == pytest.approx(expected, rel=1e-12)  # 12 digits are shown
        assert not store(settings, name, expected)


@pytest.mark.parametrize(("wanted", "step"), [(29e3, 30e3), (24e3, 20e3), (25e3, 30e3), (8e6, 1e7), (0.2, 1.0)])
def test_filter_takes_the_nearest_step_on_a_logarithmic_scale(wanted: float, step: float) -> None:
    assert nearest_step(wanted) == step
    assert step in FILTER_STEPS_HZ


def test_filters_and_time_follow_the_span_when_coupled() -> None:
    settings = Settings(detector="RMS")
    put(settings, start_hz=954e6, stop_hz=990e6)
    assert settings.rbw_hz == 300e3  # 36 MHz / 100, nearest step
    assert settings.vbw_hz == settings.rbw_hz
    assert settings.time_s == pytest.approx(max(1e-3, 2.5 * 36e6 / 300e3**2), rel=1e-12)
    put(settings, rbw_hz=30e3)
    assert settings.time_s == pytest.approx(2.5 * 36e6 / 30e3**2, rel=1e-12)
    assert settings.vbw_hz == 30e3


def test_narrow_video_filter_slows_the_coupled_sweep_unless_the_detector_is_rms() -> None:
    settings = Settings(detector="SAMP")
    put(settings, start_hz=954e6, stop_hz=990e6, rbw_hz=30e3, vbw_hz=3e3)
    assert settings.time_s == pytest.approx(10 * 2.5 * 36e6 / 30e3**2, rel=1e-12)
    settings.detector = "RMS"
    assert settings.time_s == pytest.approx(2.5 * 36e6 / 30e3**2, rel=1e-12)


def test_too_fast_sweep_is_uncalibrated() -> None:
    settings = Settings()
    put(settings, start_hz=954e6, stop_hz=990e6, rbw_hz=30e3, time_s=0.2)
    assert not settings.is_uncalibrated
    put(settings, time_s=0.05)
    assert settings.is_uncalibrated


def test_attenuator_follows_the_reference_level_when_coupled() -> None:
    settings = Settings()
    assert settings.attenuation_db == 10.0
    put(settings, reference_dbm=-30.0)
    assert settings.attenuation_db == 0.0
    put(settings, attenuation_db=5.2)
    assert settings.attenuation_db == 5.0


def test_frequency_offset_moves_what_is_shown_and_not_what_is_swept() -> None:
    settings = Settings()
    put(settings, start_hz=954e6, stop_hz=990e6, offset_hz=10e9)
    assert settings.start_hz == 954e6
    assert load(settings, "start_hz") == 10.954e9
    put(settings, center_hz=10.96e9)
    assert settings.center_hz == 960e6
    assert shown_limits(settings, "stop_hz").high == MAX_FREQUENCY_HZ + 10e9


def test_zero_span_keeps_the_filter() -> None:
    settings = Settings()
    put(settings, span_hz=10e6)
    before_hz = settings.rbw_hz
    put(settings, span_hz=0.0)
    assert (settings.span_hz, settings.rbw_hz) == (0.0, before_hz)


def test_count_of_sweeps_and_how_they_are_combined() -> None:
    assert Settings().sweeps == 1
    assert Settings(count=10).sweeps == 10
    assert Settings(average_count=5).sweeps == 1
    assert Settings(average_count=5, is_averaging=True).sweeps == 5
    assert Settings(count=10).combination == "POW"
    assert Settings(count=10, is_averaging=True).combination == "VID"
