"""Filter steps of the makes."""

import pytest

from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.instrument.settings.analyzer_model import FilterSteps, decade_steps
from analyzer_sim.instrument.settings.models import FSW_26, SSA3032X

MODELS = {name: dialect.model for name, dialect in DIALECTS.items()}


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
