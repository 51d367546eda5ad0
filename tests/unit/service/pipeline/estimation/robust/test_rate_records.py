"""Rates of the body on their way to a step of the filter."""

from dataclasses import replace

import numpy as np
from geometry_flight import MINUTE
from stepped_robust import ALIGNED_US, PAYLOAD, Stepped

from service.core.estimation.filtering.model.filter_state import RATE
from service.pipeline.estimation.robust.rate_records import with_rates
from service.pipeline.estimation.robust.telemetry_advice import telemetry_advice
from service.records.catalogue import BodyRateSensor
from service.records.inputs import TelemetryRecord
from service.records.levels.attitude import Axes

#: of an Earth-pointing spacecraft, beside some drift; deg/s
RATE_DEG_S = Axes(yaw=1e-5, roll=-5e-6, pitch=-15.0411 / 3600.0 + 2e-6)


def stepped(sensor: BodyRateSensor, minutes: tuple[float, ...]) -> Stepped:
    """Return a model whose sensor has told its rate at some minutes."""
    spacecraft = PAYLOAD.spacecraft()
    onboard = replace(spacecraft.onboard, rate_sensor=sensor)
    rates = tuple(
        TelemetryRecord(ALIGNED_US + round(minute * MINUTE), body_rate_deg_s=RATE_DEG_S) for minute in minutes
    )
    return Stepped(spacecraft=replace(spacecraft, onboard=onboard), rates=rates)


BESIDE = BodyRateSensor(in_loop=False, bias_deg_h=0.01, bias_tau_h=8.0, noise_deg_sqrt_h=0.003)


def advice(flight: Stepped) -> list[str]:
    state, epoch_us = flight.state, ALIGNED_US + MINUTE
    found = telemetry_advice(flight.model, flight.knowledge, state.momentum, state.rates, ALIGNED_US, epoch_us)
    return [name for name, is_given in found.items() if is_given]


def test_a_step_with_a_record_is_moved_by_its_rate_without_the_turn_of_the_orbit() -> None:
    flight = stepped(BESIDE, (0.5, 1.0))
    state, model = with_rates(flight.state, flight.model, flight.knowledge, ALIGNED_US + MINUTE)
    assert state.rates.is_measured
    np.testing.assert_allclose(state.filter.gaussian.mean[RATE], [0.036, -0.018, 0.0072], atol=1e-3)
    assert model.settings.drift_deg_h == (0.01, 0.01, 0.01)
    assert advice(flight) == []


def test_records_behind_the_step_later_ones_and_none_leave_it_to_the_inertial_model() -> None:
    for minutes in ((), (-11.0,), (2.0,)):
        flight = stepped(BESIDE, minutes)
        state, model = with_rates(flight.state, flight.model, flight.knowledge, ALIGNED_US + MINUTE)
        assert not state.rates.is_measured
        assert model is flight.model
        assert state.filter.gaussian is flight.state.filter.gaussian


def test_rates_of_the_loop_are_left_out_with_words() -> None:
    flight = stepped(BodyRateSensor(in_loop=True), (0.5, 1.0))
    state, _ = with_rates(flight.state, flight.model, flight.knowledge, ALIGNED_US + MINUTE)
    assert state is flight.state
    assert advice(flight) == ["rates_in_loop"]
