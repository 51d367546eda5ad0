"""Checks of wheels, polarimeter, rates and signs by a calibration."""

import math
from dataclasses import replace

import numpy as np
import pytest
from driven_world import shared_world
from geometry_payload import MINUTE, GeometryPayload, turned_angles
from turned_wheels import ALIKE, MINUTE_US, SCENARIO, WRONG, turned_deg, turned_wheels

from analyzer_sim.world.scenario.story import WheelTelemetry
from service.core.estimation.calibration.sensor_axes import MAPPINGS
from service.core.estimation.filtering.polarimeter import angle_deg, ratio_db
from service.pipeline.calibration.geometry_calibration import (
    calibrate_geometry,
    gathered_quality,
    gathered_torque,
    gathered_warnings,
)
from service.pipeline.calibration.geometry_rows import CalibrationError, CalibrationInput
from service.pipeline.calibration.paper_calibration import calibrate_paper
from service.pipeline.calibration.telemetry_checks import (
    IN_LOOP,
    axes_quality,
    momentum_check,
    momentum_warnings,
    polarimeter_checks,
    polarimeter_quality,
    polarimeter_warnings,
    rate_check,
    rate_warnings,
)
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.polarization import line_of_sight
from service.records.calibration import AxesCheck, CalibrationMethod, CalibrationRequest, MotionVerdict, Window
from service.records.catalogue import AxisTorques, BodyRateSensor, FedForwardTorque, Polarimeter, WheelMomentum
from service.records.inputs import Correction, PolarizationRecord, TelemetryRecord
from service.records.levels.attitude import Axes
from service.records.levels.measurement import ReferenceSeries

CONFIG = CalibrationConfig()
STATED = WheelMomentum(pitch_bias_n_m_s=-8.0)


def calibrated(epochs_us, seen_deg, stated, **changes):
    """Return the input of a calibration with angles of the turns that a sensor saw and what a craft states."""
    payload = GeometryPayload.make(16, quiet_days=1.0)
    start_us, stop_us = int(epochs_us[0]), int(epochs_us[-1]) + MINUTE_US
    quiet, turns = Window(start_us - 3_600_000_000, start_us), Window(start_us, stop_us)
    return replace(
        payload.data(noise_db=0.03),
        request=CalibrationRequest(quiet, turns, CalibrationMethod.GEOMETRY),
        references=(ReferenceSeries("star_tracker", epochs_us, seen_deg, np.full(seen_deg.shape, 0.01)),),
        quiet_references=(),
        spacecraft=stated(payload.spacecraft),
        **changes,
    )


def on_board(**stated):
    return lambda spacecraft: replace(spacecraft, onboard=replace(spacecraft.onboard, **stated))


def data(seed=1, *, stated=STATED, start_h=1.0, every=1, **changes):
    """Return the input of a calibration whose sensors and wheels are those of one seed."""
    turned = turned_wheels(seed, changes.pop("figures", None), start_h=start_h)
    momentum = turned.momentum @ changes.pop("matrix", np.eye(3)).T
    unloaded = changes.pop("unloaded", lambda minute: False)
    telemetry = tuple(
        TelemetryRecord(
            at_us, None, tuple(values), thrusters_active=unloaded((at_us - turned.epochs_us[0]) / MINUTE_US)
        )
        for at_us, values in zip(turned.epochs_us.tolist(), momentum.tolist(), strict=True)
    )
    return calibrated(
        turned.epochs_us, turned.attitude_deg, on_board(momentum=stated), telemetry=telemetry[::every], **changes
    )


def test_nothing_is_checked_where_the_catalogue_states_nothing():
    assert momentum_check(data(stated=None), CONFIG) is None
    assert axes_quality("momentum", None) == {}
    assert momentum_warnings(None) == ()


def test_true_telemetry_passes_in_silence_with_its_figures():
    check = momentum_check(data(), CONFIG)
    assert check.verdict is MotionVerdict.CONSISTENT
    assert momentum_warnings(check) == ()
    figures = axes_quality("momentum", check)
    assert abs(figures["momentum_response_roll"] - 1.0) < 4.0 * figures["momentum_response_roll_sigma"]
    assert figures["momentum_response_yaw_sigma"] < 0.1


@pytest.mark.parametrize("name", [*WRONG, *ALIKE])
@pytest.mark.parametrize("seed", [2, 3, 4])
def test_wrong_telemetry_is_refused_with_the_next_step(name, seed):
    matrix = WRONG[name] if name in WRONG else ALIKE[name] * np.eye(3)
    check = momentum_check(data(seed, matrix=matrix), CONFIG)
    assert check.verdict is MotionVerdict.CONTRADICTED
    (text,) = momentum_warnings(check)
    assert "the filter does not use it under this calibration; correct sign, order of axes, unit" in text


def test_what_all_axes_share_stays_open_without_a_stated_bias():
    check = momentum_check(data(matrix=0.7376 * np.eye(3), stated=WheelMomentum()), CONFIG)
    assert check.verdict is MotionVerdict.CONSISTENT
    assert "state onboard.momentum.pitch_bias_n_m_s" in momentum_warnings(check)[0]


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"every": 12}, "9 records of momentum within the turns, 20 are needed"),
        ({"figures": WheelTelemetry(bias_n_m_s=0.0), "stated": WheelMomentum(pitch_bias_n_m_s=0.0)}, "N m s along pit"),
        ({"start_h": 7.0, "unloaded": lambda minute: minute % 60.0 == 0.0}, "unload before the turns"),
    ],
)
def test_what_was_not_checked_is_said_with_its_reason(changes, reason):
    check = momentum_check(data(**changes), CONFIG)
    assert check.verdict is MotionVerdict.UNCHECKED
    (text,) = momentum_warnings(check)
    assert text.startswith("the momentum of the wheels in telemetry was not checked: ")
    assert reason in text


FEED = Polarimeter("p", 10.0, 11e9)
SEED = 6


def polarimeter_data(scale=1.0, stated=(FEED,), records=None):
    """Return the input of a calibration whose polarimeter sees turns by a scale, its feed turned by 10 deg and more."""
    rng, angles = np.random.default_rng(SEED), turned_deg()
    epochs_us = SCENARIO.start_us + MINUTE_US * np.arange(len(angles))
    sight = line_of_sight(GeometryPayload.make(16, quiet_days=1.0).spacecraft, FEED)
    seen = scale * angles @ np.array(sight) + 0.8 + rng.normal(0.0, 0.07, len(angles))
    told = zip(epochs_us.tolist(), seen.tolist(), strict=True)
    made = calibrated(
        epochs_us,
        angles + rng.normal(0.0, 0.01, angles.shape),
        lambda spacecraft: replace(spacecraft, polarimeters=stated),
        polarization=tuple(PolarizationRecord("p", at_us, ratio_db(10.0, angle)) for at_us, angle in told)[:records],
    )
    return replace(made, ephemeris=replace(made.ephemeris, track=None))


def test_nothing_is_checked_where_the_catalogue_uses_none():
    for stated in ((), (replace(FEED, used=False),)):
        assert polarimeter_checks(polarimeter_data(stated=stated), CONFIG) == ()
    assert polarimeter_checks(replace(polarimeter_data(), spacecraft=None), CONFIG) == ()
    assert polarimeter_quality(()) == {}
    assert polarimeter_warnings(()) == ()


def test_a_true_one_passes_in_silence_with_its_figures():
    checks = polarimeter_checks(polarimeter_data(), CONFIG)
    assert [check.verdict for check in checks] == [MotionVerdict.CONSISTENT]
    assert polarimeter_warnings(checks) == ()
    figures = polarimeter_quality(checks)
    assert abs(figures["polarimeter_response"] - 1.0) < 4.0 * figures["polarimeter_response_sigma"]


@pytest.mark.parametrize("scale", [-1.0, 0.5, 2.0])
def test_a_wrong_one_is_refused_with_figures_and_the_next_step(scale):
    checks = polarimeter_checks(polarimeter_data(scale), CONFIG)
    (check,) = checks
    assert check.verdict is MotionVerdict.CONTRADICTED
    assert math.isclose(check.response, scale, abs_tol=0.15)
    (text,) = polarimeter_warnings(checks)
    assert text.startswith(f"polarimeter p is refused: its angle follows the turns by {check.response:+.2f}")
    assert "correct the sign of feed_offset_deg" in text


@pytest.mark.parametrize(
    ("records", "reason"), [(19, "19 records within the turns, 20 are needed"), (40, "too few turns")]
)
def test_too_little_is_not_checked_and_says_why(records, reason):
    checks = polarimeter_checks(polarimeter_data(records=records), CONFIG)
    assert [check.verdict for check in checks] == [MotionVerdict.UNCHECKED]
    assert reason in polarimeter_warnings(checks)[0]


def test_the_feed_is_told_with_its_leakage_whatever_the_catalogue_states():
    (check,), (other,) = (
        polarimeter_checks(polarimeter_data(stated=(replace(FEED, feed_offset_deg=at),)), CONFIG) for at in (10, 9)
    )
    sigma_deg = math.sqrt(check.feed.covariance[0][0])
    assert check.feed.mean[0] == pytest.approx(10.8, abs=4.0 * sigma_deg)
    assert other.feed.mean == pytest.approx(check.feed.mean, abs=1e-3)
    figures = polarimeter_quality((check,))
    assert figures["polarimeter_feed_turn_deg"] == check.feed.mean[0]
    assert figures["polarimeter_feed_turn_sigma_deg"] == sigma_deg
    assert figures["polarimeter_leakage_sigma_deg"] == pytest.approx(0.72, abs=0.02)
    assert figures["polarimeter_daily_deg"] == pytest.approx(math.hypot(*check.feed.mean[1:]))


def test_a_feed_far_from_where_the_catalogue_puts_it_is_named_and_used():
    checks = polarimeter_checks(polarimeter_data(stated=(replace(FEED, feed_offset_deg=5.0),)), CONFIG)
    assert [check.verdict for check in checks] == [MotionVerdict.CONSISTENT]
    (text,) = polarimeter_warnings(checks)
    assert text.startswith("polarimeter p is used: its feed is turned by 11.0 +- 0.7 deg, the catalogue states 5;")


def test_angles_and_ratios_with_a_feed_of_their_own_tell_nothing_of_a_feed():
    made = polarimeter_data()
    own = tuple(replace(one, feed_offset_deg=10.0) for one in made.polarization)
    angles = tuple(replace(one, ratio_db=None, angle_deg=angle_deg(10.0, one.ratio_db or 0.0)) for one in own)
    for records in (own, angles):
        (check,) = polarimeter_checks(replace(made, polarization=records), CONFIG)
        assert (check.verdict, check.feed) == (MotionVerdict.CONSISTENT, None)


GYRO = BodyRateSensor(in_loop=False, bias_deg_h=0.01, bias_tau_h=8.0, noise_deg_sqrt_h=0.003)
RATE_SEED, W_PER_H = 5, 0.2625162


def rate_data(stated=GYRO, matrix=None, records=None):
    """Return the input of a calibration whose rates are a matrix times the truth, yaw, roll, pitch, deg/s."""
    rng, angles = np.random.default_rng(RATE_SEED), turned_deg()
    turned = np.diff(angles, axis=0) * 60.0
    yaw, roll, pitch = (0.5 * (angles[1:] + angles[:-1])).T
    turned += W_PER_H * np.column_stack([roll, -yaw, 0.0 * pitch]) - np.array([0.0, 0.0, np.rad2deg(W_PER_H)])
    turned += rng.normal(0.0, 0.02, turned.shape)
    epochs_us = SCENARIO.start_us + MINUTE_US * np.arange(len(angles))
    rates = turned @ (np.eye(3) if matrix is None else matrix).T / 3600.0
    telemetry = [
        TelemetryRecord(epoch_us, body_rate_deg_s=Axes(*values))
        for epoch_us, values in zip(epochs_us[1:].tolist(), rates.tolist(), strict=True)
    ]
    seen = angles + rng.normal(0.0, 0.01, angles.shape)
    return calibrated(epochs_us, seen, on_board(rate_sensor=stated), telemetry=tuple(telemetry[:records]))


def test_nothing_is_checked_where_the_catalogue_states_no_sensor_or_one_in_the_loop():
    assert rate_check(rate_data(None), CONFIG) is None
    assert axes_quality("rate", None) == {}
    assert rate_warnings(rate_data(None), None) == ()
    looped = rate_data(BodyRateSensor(in_loop=True))
    assert rate_check(looped, CONFIG) is None
    assert rate_warnings(looped, None) == (IN_LOOP,)


def test_true_rates_pass_in_silence_with_their_figures():
    given = rate_data()
    check = rate_check(given, CONFIG)
    assert check.verdict is MotionVerdict.CONSISTENT
    assert rate_warnings(given, check) == ()
    figures = axes_quality("rate", check)
    for axis in ("roll", "pitch", "yaw"):
        assert abs(figures[f"rate_response_{axis}"] - 1.0) < 0.05
        assert figures[f"rate_response_{axis}_sigma"] < 0.05


@pytest.mark.parametrize(
    ("name", "matrix"),
    [
        ("sign of yaw", np.diag([-1.0, 1.0, 1.0])),
        ("sign of pitch", np.diag([1.0, 1.0, -1.0])),
        ("roll and yaw exchanged", np.eye(3)[[1, 0, 2]]),
        ("deg/h", 3600.0 * np.eye(3)),
        ("rad/s", np.radians(1.0) * np.eye(3)),
    ],
)
def test_wrong_rates_are_refused_with_figures_and_the_next_step(name, matrix):
    given = rate_data(matrix=matrix)
    check = rate_check(given, CONFIG)
    assert check is not None, name
    assert check.verdict is MotionVerdict.CONTRADICTED
    (text,) = rate_warnings(given, check)
    assert "sigma (turns about yaw by" in text
    assert "the filter does not use them under this calibration; correct sign, order of axes, unit" in text


@pytest.mark.parametrize(("records", "reason"), [(19, "19 records of rates within the turns, 20 are needed"), (40, "")])
def test_too_few_records_are_not_checked_and_say_why(records, reason):
    given = rate_data(records=records)
    check = rate_check(given, CONFIG)
    assert check.verdict is MotionVerdict.UNCHECKED
    (text,) = rate_warnings(given, check)
    assert text.startswith("the rates of the body in telemetry were not checked: ")
    assert reason in text


YAW, ROLL, PITCH = np.diag([-1.0, 1, 1]), np.diag([1.0, -1, 1]), np.diag([1.0, 1, -1])
EXCHANGED = {
    "exchanged axes (roll, pitch)": np.eye(3)[[0, 2, 1]],
    "exchanged axes (yaw, roll)": np.eye(3)[[1, 0, 2]],
    "exchanged axes (yaw, pitch)": np.eye(3)[[2, 1, 0]],
    "exchanged axes (yaw, roll, pitch)": np.eye(3)[[1, 2, 0]],
}


@pytest.fixture(scope="module")
def signs():
    """Sixteen carriers, everything as it should be."""
    return GeometryPayload.make(16, quiet_days=1.0).data(noise_db=0.03)


def reported(signs, matrix):
    """Return the input with sensors that tell ``matrix @ angles``."""

    def changed(series):
        return tuple(replace(one, attitude_deg=one.attitude_deg @ np.asarray(matrix).T) for one in series)

    return replace(signs, references=changed(signs.references), quiet_references=changed(signs.quiet_references))


def refusal(signs, calibrate=calibrate_geometry):
    with pytest.raises(CalibrationError) as caught:
        calibrate(signs, CONFIG)
    return str(caught.value)


@pytest.mark.parametrize("calibrate", [calibrate_geometry, calibrate_paper])
@pytest.mark.parametrize(
    ("matrix", "names"),
    [
        (YAW, "likely flipped yaw, or flipped roll, pitch ("),
        pytest.param(ROLL, "likely flipped roll, or flipped yaw, pitch (", marks=pytest.mark.slow),
        pytest.param(PITCH, "likely flipped pitch, or flipped yaw, roll (", marks=pytest.mark.slow),
    ],
)
def test_a_flipped_axis_is_refused_by_name(signs, calibrate, matrix, names):
    text = refusal(reported(signs, matrix), calibrate)
    assert text.startswith("the powers contradict the axes of star_tracker by ")
    assert names in text
    assert "roll > 0 moves stations South, pitch > 0 West" in text


@pytest.mark.slow
@pytest.mark.parametrize("name", EXCHANGED)
def test_exchanged_axes_are_refused_by_name(signs, name):
    assert f"likely {name}" in refusal(reported(signs, EXCHANGED[name]))


def test_a_healthy_sensor_is_proven_and_silent(signs):
    for calibrate in (calibrate_geometry, calibrate_paper):
        result = calibrate(signs, CONFIG)
        assert result.signs.is_yaw_proven
        assert not [text for text in result.warnings if "sign" in text or "scale" in text]
        for axis in ("pitch", "roll"):
            value, sigma = (result.quality[f"yaw_on_{axis}_slope{end}"] for end in ("", "_sigma"))
            assert abs(value - 1.0) < 4.0 * sigma < 0.5


def announced(signs, sign):
    """Return corrections that announce the slews of the turns."""
    start_us, angles = signs.request.turns.start_us, turned_angles()
    steps = [k for k in range(1, len(angles)) if np.abs(angles[k] - angles[k - 1]).max() > 0.0]
    return tuple(
        Correction(start_us + (k - 1) * MINUTE, start_us + k * MINUTE, Axes(*(sign * (angles[k] - angles[k - 1]))))
        for k in steps
    )


@pytest.mark.slow
def test_the_common_sign_is_unproven_without_and_proven_with_announced_turns(signs):
    assert not calibrate_geometry(signs, CONFIG).signs.is_common_proven
    assert calibrate_geometry(replace(signs, corrections=announced(signs, 1.0)), CONFIG).signs.is_common_proven


@pytest.mark.slow
def test_a_sensor_with_all_axes_flipped_contradicts_the_announced_turns(signs):
    flipped = reported(signs, -np.eye(3))
    assert not calibrate_geometry(flipped, CONFIG).signs.is_common_proven
    text = refusal(replace(flipped, corrections=announced(signs, 1.0)))
    assert "likely flipped yaw, roll, pitch" in text


def test_announced_turns_tell_one_flip_from_its_twin(signs):
    text = refusal(reported(replace(signs, corrections=announced(signs, 1.0)), YAW))
    assert "likely flipped yaw (" in text


def test_yaw_turns_that_are_too_small_prove_nothing(signs):
    turned = turned_angles()
    turned[:, 0] *= 0.2
    payload = GeometryPayload.make(16, quiet_days=1.0)
    result = calibrate_geometry(payload.data(noise_db=0.03, turned=turned), CONFIG)
    assert result.quality["yaw_turn_reach_deg"] < 0.3
    assert not result.signs.is_yaw_proven
    assert any(text.startswith("the sign of yaw is unproven: yaw was turned by 0.") for text in result.warnings)


@pytest.mark.parametrize(
    ("axis", "name"),
    [(0, "yaw"), *(pytest.param(*each, marks=pytest.mark.slow) for each in [(1, "roll"), (2, "pitch")])],
)
def test_a_scale_that_is_off_is_warned_of(signs, axis, name):
    scale = np.ones(3)
    scale[axis] = 1.9
    result = calibrate_geometry(reported(signs, np.diag(scale)), CONFIG)
    assert [text for text in result.warnings if text.startswith(f"the scale of the {name} sensor differs")]


def test_a_scale_below_a_tenth_is_silent(signs):
    result = calibrate_geometry(reported(signs, np.diag([1.05, 1.0, 1.0])), CONFIG)
    assert not any("scale" in text for text in result.warnings)


def test_four_carriers_leave_the_sign_open():
    result = calibrate_geometry(GeometryPayload.make(4, quiet_days=1.0).data(), CONFIG)
    assert (result.signs.is_yaw_proven, result.signs.is_common_proven) == (False, False)
    assert any(text.startswith("the sign of yaw is unproven: too few carriers") for text in result.warnings)


def test_the_names_cover_all_mistakes():
    assert np.array_equal(MAPPINGS[0], np.eye(3))
    assert len({mapping.tobytes() for mapping in MAPPINGS}) == 48
    assert all(abs(round(np.linalg.det(mapping))) == 1 for mapping in MAPPINGS)


SENSOR = np.full(3, 0.01)
GOOD = AxesCheck(MotionVerdict.CONSISTENT, "")
TORQUE_SEED = 1


@pytest.fixture(scope="module")
def told():
    """Return the input of a simulated calibration with wheels."""
    world = shared_world("wheels", TORQUE_SEED, 0.5)
    ground, documents = world.ground, world.documents
    calibration = documents.calibrations[1]
    quiet, turns = ground.phases["quiet"], ground.phases["turns"]
    return CalibrationInput(
        calibration.request,
        documents.plans[1],
        documents.ephemerides[1],
        ground.series(quiet, documents.plans[1].carrier_ids),
        ground.series(turns, documents.plans[1].carrier_ids),
        ground.references_in(turns),
        ground.references_in(quiet),
        ground.spacecraft,
        telemetry=tuple(e.content for e in ground.events if isinstance(e.content, TelemetryRecord)),
    )


def learned(data, check=GOOD):
    return gathered_torque(data, check, SENSOR, CONFIG)


def test_quiet_days_tell_the_torque_and_its_figures(told):
    found = learned(told, momentum_check(told, CONFIG))
    figures = gathered_quality(found)
    assert found.stop_us == told.request.quiet.stop_us
    # records each 5 min of three days; waves of 1e-5 N m are the simulator's, and a constant torque is known by the
    # misalignment of 0.05 deg alone
    assert figures["gathered_torque_records"] == 864.0
    for name in ("yaw", "roll", "pitch"):
        assert abs(figures[f"gathered_daily_{name}_n_m"] - 1e-5) < 4e-7
        assert figures[f"gathered_{name}_sigma_n_m"] < 6e-7
    assert gathered_warnings(told, GOOD, found) == ()


def test_nothing_is_learned_without_momentum_or_of_telemetry_that_turns_contradict(told):
    assert learned(told, None) is None
    assert learned(told, AxesCheck(MotionVerdict.CONTRADICTED, "wrong")) is None
    assert gathered_warnings(told, AxesCheck(MotionVerdict.CONTRADICTED, "wrong"), None) == ()
    assert gathered_quality(None) == {}


def test_too_few_records_are_told_with_their_number(told):
    quiet = told.request.quiet
    short = replace(
        told, request=replace(told.request, quiet=Window(quiet.start_us, quiet.start_us + 3 * 3_600_000_000))
    )
    assert learned(short) is None
    (text,) = gathered_warnings(short, GOOD, None)
    assert "36 records of momentum within the quiet days, 50 are needed" in text
    assert "onboard.momentum.torque" in text


def test_days_without_angles_are_told(told):
    blind = replace(told, quiet_references=())
    assert learned(blind) is None
    (text,) = gathered_warnings(blind, GOOD, None)
    assert "no sensor tells the angles" in text


@pytest.mark.slow
def test_a_stated_torque_of_the_wrong_sign_is_told(told):
    spacecraft = told.spacecraft
    momentum = spacecraft.onboard.momentum
    assert momentum.torque is not None
    turned = {
        name: AxisTorques(*(-getattr(getattr(momentum.torque, name), axis) for axis in ("yaw", "roll", "pitch")))
        for name in ("constant_n_m", "cosine_n_m", "sine_n_m")
    }
    wrong = replace(momentum, torque=replace(momentum.torque, **turned))
    data = replace(told, spacecraft=replace(spacecraft, onboard=replace(spacecraft.onboard, momentum=wrong)))
    found = learned(data)
    assert found == learned(told)
    (text,) = gathered_warnings(data, GOOD, found)
    assert "differs from onboard.momentum.torque by" in text


@pytest.mark.slow
def test_nothing_is_said_where_the_torque_is_fed_forward(told):
    spacecraft = told.spacecraft
    onboard = replace(spacecraft.onboard, fed_forward_torque=FedForwardTorque(epoch_us=0))
    data = replace(told, spacecraft=replace(spacecraft, onboard=onboard))
    assert gathered_warnings(data, GOOD, None) == ()
