"""Limits of the numeric settings and what storing them does."""

from dataclasses import replace

import pytest

from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.instrument.settings.analyzer_model import AnalyzerModel
from analyzer_sim.instrument.settings.instrument_settings import Settings, reset_state
from analyzer_sim.instrument.settings.models import FSW_26, SSA3032X
from analyzer_sim.instrument.settings.quantities import QUANTITIES, load, shown_limits, store

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
