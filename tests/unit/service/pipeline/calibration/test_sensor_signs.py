"""A calibration with a sensor of wrong signs, order or scale: refused by name, warned of, or said to be unproven."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_payload import MINUTE, GeometryPayload, turned_angles

from service.core.estimation.calibration.checks.sensor_axes import MAPPINGS
from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.calibration.paper_calibration import calibrate_paper
from service.pipeline.calibration.windows import CalibrationError
from service.pipeline.config import CalibrationConfig
from service.records.inputs import Correction
from service.records.levels.attitude import Axes

CONFIG = CalibrationConfig()
YAW, ROLL, PITCH = np.diag([-1.0, 1, 1]), np.diag([1.0, -1, 1]), np.diag([1.0, 1, -1])
EXCHANGED = {
    "exchanged axes (roll, pitch)": np.eye(3)[[0, 2, 1]],
    "exchanged axes (yaw, roll)": np.eye(3)[[1, 0, 2]],
    "exchanged axes (yaw, pitch)": np.eye(3)[[2, 1, 0]],
    "exchanged axes (yaw, roll, pitch)": np.eye(3)[[1, 2, 0]],
}


@pytest.fixture(scope="module")
def data():
    """Sixteen carriers, everything as it should be."""
    return GeometryPayload.make(16, quiet_days=1.0).data(noise_db=0.03)


def reported(data, matrix):
    """Return the input with sensors that tell ``matrix @ angles``."""

    def changed(series):
        return tuple(replace(one, attitude_deg=one.attitude_deg @ np.asarray(matrix).T) for one in series)

    return replace(data, references=changed(data.references), quiet_references=changed(data.quiet_references))


def refusal(data, calibrate=calibrate_geometry):
    with pytest.raises(CalibrationError) as caught:
        calibrate(data, CONFIG)
    return str(caught.value)


@pytest.mark.parametrize("calibrate", [calibrate_geometry, calibrate_paper])
@pytest.mark.parametrize(
    ("matrix", "names"),
    [
        (YAW, "likely flipped yaw, or flipped roll, pitch ("),
        (ROLL, "likely flipped roll, or flipped yaw, pitch ("),
        (PITCH, "likely flipped pitch, or flipped yaw, roll ("),
    ],
)
def test_a_flipped_axis_is_refused_by_name(data, calibrate, matrix, names):
    text = refusal(reported(data, matrix), calibrate)
    assert text.startswith("the powers contradict the axes of star_tracker by ")
    assert names in text
    assert "roll > 0 moves stations South, pitch > 0 West" in text


@pytest.mark.parametrize("name", EXCHANGED)
def test_exchanged_axes_are_refused_by_name(data, name):
    assert f"likely {name}" in refusal(reported(data, EXCHANGED[name]))


def test_a_healthy_sensor_is_proven_and_silent(data):
    for calibrate in (calibrate_geometry, calibrate_paper):
        result = calibrate(data, CONFIG)
        assert result.signs.is_yaw_proven
        assert not [text for text in result.warnings if "sign" in text or "scale" in text]
        for axis in ("pitch", "roll"):
            value, sigma = (result.quality[f"yaw_on_{axis}_slope{end}"] for end in ("", "_sigma"))
            assert abs(value - 1.0) < 4.0 * sigma < 0.5


def announced(data, sign):
    """Return corrections that announce the slews of the turns."""
    start_us, angles = data.request.turns.start_us, turned_angles()
    steps = [k for k in range(1, len(angles)) if np.abs(angles[k] - angles[k - 1]).max() > 0.0]
    return tuple(
        Correction(start_us + (k - 1) * MINUTE, start_us + k * MINUTE, Axes(*(sign * (angles[k] - angles[k - 1]))))
        for k in steps
    )


def test_the_common_sign_is_unproven_without_and_proven_with_announced_turns(data):
    assert not calibrate_geometry(data, CONFIG).signs.is_common_proven
    assert calibrate_geometry(replace(data, corrections=announced(data, 1.0)), CONFIG).signs.is_common_proven


def test_a_sensor_with_all_axes_flipped_contradicts_the_announced_turns(data):
    flipped = reported(data, -np.eye(3))
    assert not calibrate_geometry(flipped, CONFIG).signs.is_common_proven
    text = refusal(replace(flipped, corrections=announced(data, 1.0)))
    assert "likely flipped yaw, roll, pitch" in text


def test_announced_turns_tell_one_flip_from_its_twin(data):
    text = refusal(reported(replace(data, corrections=announced(data, 1.0)), YAW))
    assert "likely flipped yaw (" in text


def test_yaw_turns_that_are_too_small_prove_nothing(data):
    turned = turned_angles()
    turned[:, 0] *= 0.2
    payload = GeometryPayload.make(16, quiet_days=1.0)
    result = calibrate_geometry(payload.data(noise_db=0.03, turned=turned), CONFIG)
    assert result.quality["yaw_turn_reach_deg"] < 0.3
    assert not result.signs.is_yaw_proven
    assert any(text.startswith("the sign of yaw is unproven: yaw was turned by 0.") for text in result.warnings)


@pytest.mark.parametrize(("axis", "name"), [(0, "yaw"), (1, "roll"), (2, "pitch")])
def test_a_scale_that_is_off_is_warned_of(data, axis, name):
    scale = np.ones(3)
    scale[axis] = 1.9
    result = calibrate_geometry(reported(data, np.diag(scale)), CONFIG)
    assert [text for text in result.warnings if text.startswith(f"the scale of the {name} sensor differs")]


def test_a_scale_below_a_tenth_is_silent(data):
    result = calibrate_geometry(reported(data, np.diag([1.05, 1.0, 1.0])), CONFIG)
    assert not any("scale" in text for text in result.warnings)


def test_four_carriers_leave_the_sign_open():
    result = calibrate_geometry(GeometryPayload.make(4, quiet_days=1.0).data(), CONFIG)
    assert (result.signs.is_yaw_proven, result.signs.is_common_proven) == (False, False)
    assert any(text.startswith("the sign of yaw is unproven: too few carriers") for text in result.warnings)


def test_the_names_cover_all_mistakes():
    assert np.array_equal(MAPPINGS[0], np.eye(3))
    assert len({mapping.tobytes() for mapping in MAPPINGS}) == 48
    assert all(abs(round(np.linalg.det(mapping))) == 1 for mapping in MAPPINGS)
