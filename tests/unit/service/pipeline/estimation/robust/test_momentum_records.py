"""Records of the wheels on their way to the filter: what cannot be theirs is left out."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import MINUTE
from stepped_robust import ALIGNED_US, PAYLOAD, Stepped

from service.core.estimation.filtering.model.filter_state import core_size
from service.core.estimation.filtering.model.hidden_motion import sensors_first
from service.pipeline.estimation.robust.method import carried_state
from service.pipeline.estimation.robust.momentum_records import with_momenta
from service.records.calibration import Calibration, GatheredTorque
from service.records.catalogue import WheelMomentum
from service.records.inputs import TelemetryRecord


def flight(pitch_n_m_s: float, bias_n_m_s: float | None) -> Stepped:
    """Return a filter at its alignment, whose wheels have told a momentum along pitch."""
    spacecraft = PAYLOAD.spacecraft()
    onboard = replace(spacecraft.onboard, momentum=WheelMomentum(pitch_bias_n_m_s=bias_n_m_s))
    axes = np.array(spacecraft.wheels.axes)
    wheels = tuple((np.array([0.3, pitch_n_m_s, -0.2]) @ np.linalg.pinv(axes)).tolist())
    record = TelemetryRecord(ALIGNED_US, wheel_momentum_n_m_s=wheels)
    return Stepped(spacecraft=replace(spacecraft, onboard=onboard), momenta=(record,))


@pytest.mark.parametrize(
    ("pitch_n_m_s", "bias_n_m_s", "is_refused"),
    [
        pytest.param(-8.1, -8.0, False, id="as stated"),
        pytest.param(-4.5, -8.0, False, id="gathered since the unloading"),
        pytest.param(-0.008, -8.0, True, id="another unit"),
        pytest.param(8.0, -8.0, True, id="another sign"),
        pytest.param(-0.008, None, False, id="nothing stated"),
        pytest.param(2.0, 0.5, False, id="next to no bias"),
        pytest.param(1e4, None, True, id="more than a wheel holds"),
    ],
)
def test_a_first_record_that_cannot_be_that_of_the_spacecraft_refuses_the_telemetry(
    pitch_n_m_s: float, bias_n_m_s: float | None, is_refused: bool
) -> None:
    before = flight(pitch_n_m_s, bias_n_m_s)
    after, _ = with_momenta(before.state, before.model, before.knowledge)
    assert after.momentum.is_refused == is_refused
    # telemetry that is refused moves no state
    assert (after.filter.gaussian is before.state.filter.gaussian) == is_refused


def test_a_later_one_is_left_out_alone() -> None:
    good, wild = flight(-8.0, -8.0), flight(-1.0, -8.0)
    state, _ = with_momenta(good.state, good.model, good.knowledge)
    after, _ = with_momenta(state, wild.model, wild.knowledge)
    assert not after.momentum.is_refused
    assert after.filter is state.filter


def test_every_record_of_a_batch_is_used_once_in_its_order() -> None:
    """Of minutes before a row each counts; what is later, or older than 15 min, does not."""
    first = flight(-8.0, None)
    spacecraft, axes = first.knowledge.spacecraft, np.array(first.knowledge.spacecraft.wheels.axes)
    rng = np.random.default_rng(7)
    minutes = (-15.01, -15.0, -9.0, -4.0, 0.0, 1.0)
    batch = tuple(
        TelemetryRecord(
            ALIGNED_US + round(minute * MINUTE),
            wheel_momentum_n_m_s=tuple((rng.normal([0.3, -8.0, -0.2], 0.01) @ np.linalg.pinv(axes)).tolist()),
        )
        for minute in minutes
    )
    at_once = Stepped(spacecraft=spacecraft, momenta=batch)
    none_yet, effects = with_momenta(at_once.state, at_once.model, replace(at_once.knowledge, momenta=batch[:1]))
    assert (none_yet, effects) == (at_once.state, []), "older than 15 min"
    # one of before the alignment serves while none follows
    one_by_one, effects = with_momenta(at_once.state, at_once.model, replace(at_once.knowledge, momenta=batch[:4]))
    assert (len(effects), one_by_one.momentum.newest_us) == (1, batch[3].epoch_us)
    first, effects = with_momenta(at_once.state, at_once.model, at_once.knowledge)
    assert (len(effects), first.momentum.newest_us) == (1, ALIGNED_US)
    alignment = replace(at_once.knowledge.alignment, epoch_us=ALIGNED_US - 60 * MINUTE)
    at_once.knowledge = replace(at_once.knowledge, alignment=alignment)
    state, effects = with_momenta(at_once.state, at_once.model, at_once.knowledge)
    assert [effect.update is not None for effect in effects] == [True] * 4
    assert state.momentum.newest_us == ALIGNED_US
    one_by_one = at_once.state
    for record in batch[1:5]:
        one_by_one, _ = with_momenta(one_by_one, at_once.model, replace(at_once.knowledge, momenta=(record,)))
    np.testing.assert_array_equal(state.filter.gaussian.covariance, one_by_one.filter.gaussian.covariance)
    begin = sensors_first(at_once.model.filter, state.filter.gaussian, at_once.model.settings)
    own = slice(begin, begin + 3)
    sigmas = [np.sqrt(each.filter.gaussian.covariance.diagonal()[own]) for each in (state, first)]
    assert (sigmas[0] < 0.75 * sigmas[1]).all()
    assert with_momenta(state, at_once.model, at_once.knowledge) == (state, [])


def learned(number: int, factor: float) -> Calibration:
    """Return a calibration whose quiet days told a torque."""
    made = PAYLOAD.calibration()
    assert made.result is not None
    mean = (*(factor * 1e-6 * part for part in range(1, 10)), 0.01, -0.01, 1e-3, 2e-3)
    gathered = GatheredTorque(mean, tuple(map(tuple, (1e-16 * np.eye(13)).tolist())), 800, 0)
    return replace(made, id=number, result=replace(made.result, gathered=gathered))


def test_a_calibration_with_another_torque_changes_nothing_in_a_filter_that_runs() -> None:
    spacecraft = PAYLOAD.spacecraft()
    stated = replace(spacecraft, onboard=replace(spacecraft.onboard, momentum=WheelMomentum()))
    old, new = (
        Stepped(spacecraft=stated, calibration=learned(number, factor)) for number, factor in ((1, 1.0), (2, 3.0))
    )
    assert old.model.settings.momentum != new.model.settings.momentum
    carried = carried_state(old.state, old.model, new.model)
    own = slice(core_size(new.model.filter), core_size(new.model.filter, 16))
    assert np.abs(old.state.filter.gaussian.mean[own]).max() > 0.0
    np.testing.assert_array_equal(carried.filter.gaussian.mean[own], old.state.filter.gaussian.mean[own])
    # a filter that begins under it has its torque
    began = new.state.filter.gaussian.mean[own][:9]
    np.testing.assert_allclose(began, 3.0 * old.state.filter.gaussian.mean[own][:9], rtol=1e-9)
