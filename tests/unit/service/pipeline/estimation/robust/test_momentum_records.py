"""Records of the wheels on their way to the filter: what cannot be theirs is left out."""

from dataclasses import replace

import numpy as np
import pytest
from stepped_robust import ALIGNED_US, PAYLOAD, Stepped

from service.pipeline.estimation.robust.momentum_records import with_record
from service.records.catalogue import WheelMomentum
from service.records.inputs import TelemetryRecord


def flight(pitch_n_m_s: float, bias_n_m_s: float | None) -> Stepped:
    """Return a filter at its alignment, whose wheels have told a momentum along pitch."""
    spacecraft = PAYLOAD.spacecraft()
    onboard = replace(spacecraft.onboard, momentum=WheelMomentum(pitch_bias_n_m_s=bias_n_m_s))
    axes = np.array(spacecraft.wheels.axes)
    wheels = tuple((np.array([0.3, pitch_n_m_s, -0.2]) @ np.linalg.pinv(axes)).tolist())
    record = TelemetryRecord(ALIGNED_US, wheel_momentum_n_m_s=wheels)
    return Stepped(spacecraft=replace(spacecraft, onboard=onboard), telemetry=record)


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
    after, _ = with_record(before.state, before.model, before.knowledge)
    assert after.momentum.is_refused == is_refused
    # telemetry that is refused moves no state
    assert (after.filter.gaussian is before.state.filter.gaussian) == is_refused


def test_a_later_one_is_left_out_alone() -> None:
    good, wild = flight(-8.0, -8.0), flight(-1.0, -8.0)
    state, _ = with_record(good.state, good.model, good.knowledge)
    after, _ = with_record(state, wild.model, wild.knowledge)
    assert not after.momentum.is_refused
    assert after.filter is state.filter
