"""Axes of the sensor in the simulator's worlds: healthy ones are silent and proven, mistakes are refused by name."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_world import calibration_input

from analyzer_sim.export import export_arrays
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World
from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.calibration.windows import CalibrationError
from service.pipeline.config import CalibrationConfig

#: what the sensor tells of yaw, roll, pitch, and how the refusal names it
MISTAKES = {
    "flipped yaw": np.diag([-1.0, 1.0, 1.0]),
    "flipped roll": np.diag([1.0, -1.0, 1.0]),
    "flipped pitch": np.diag([1.0, 1.0, -1.0]),
    "flipped roll, pitch": np.diag([1.0, -1.0, -1.0]),
    "flipped yaw, roll, pitch": -np.eye(3),
    "exchanged axes (roll, pitch)": np.eye(3)[[0, 2, 1]],
    "exchanged axes (yaw, roll)": np.eye(3)[[1, 0, 2]],
    "exchanged axes (yaw, pitch)": np.eye(3)[[2, 1, 0]],
}
#: one of each kind in every run: tests/unit judges all of them on a fit of its own
AT_EVERY_RUN = ("flipped yaw", "exchanged axes (yaw, roll)")


def windows(name, seed):
    return calibration_input(export_arrays(World(scenario_named(name, operation_days=0.1), seed)))


def reported(data, matrix):
    def changed(series):
        return tuple(replace(one, attitude_deg=one.attitude_deg @ matrix.T) for one in series)

    return replace(data, references=changed(data.references), quiet_references=changed(data.quiet_references))


@pytest.fixture(scope="module")
def nominal():
    """The quiet days and turns of `nominal`, seed 2."""
    return windows("nominal", 2)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in AT_EVERY_RUN else pytest.mark.slow) for name in MISTAKES]
)
def test_a_mistake_on_a_healthy_world_is_refused_by_name(nominal, name):
    with pytest.raises(CalibrationError) as caught:
        calibrate_geometry(reported(nominal, MISTAKES[name]), CalibrationConfig())
    print(caught.value)
    assert f"; likely {name} (" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        ("nominal", 1),
        ("dual_band", 11),
        *(
            pytest.param(name, seed, marks=pytest.mark.slow)
            for name, seed in (("octants", 4), ("flicker", 12), ("few8", 11), ("many32", 11), ("alc", 11))
        ),
    ],
)
def test_a_healthy_world_is_proven_and_silent(name, seed):
    result = calibrate_geometry(windows(name, seed), CalibrationConfig())
    signs = {key: round(value, 2) for key, value in result.quality.items() if key.startswith("yaw_on")}
    print(f"{name}, seed {seed}: {signs}")
    assert result.signs.is_yaw_proven
    assert result.signs.is_common_proven
    assert not [text for text in result.warnings if "sign" in text or "scale" in text]
