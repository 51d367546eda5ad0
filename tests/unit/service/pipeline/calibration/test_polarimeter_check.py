"""Check of polarimeters at calibration: what is passed, what is refused, and why something was not checked."""

import math
from dataclasses import replace

import numpy as np
import pytest
from geometry_payload import GeometryPayload
from turned_wheels import MINUTE_US, SCENARIO, turned_deg

from service.core.estimation.filtering.model.polarimeter import angle_deg, ratio_db
from service.pipeline.calibration.polarimeter_check import polarimeter_checks, polarimeter_quality, polarimeter_warnings
from service.pipeline.calibration.windows import CalibrationInput
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.polarization import line_of_sight
from service.records.calibration import CalibrationMethod, CalibrationRequest, MotionVerdict, Window
from service.records.catalogue import Polarimeter
from service.records.inputs import PolarizationRecord
from service.records.levels.series import ReferenceSeries

CONFIG = CalibrationConfig()
STATED = Polarimeter("p", 10.0, 11e9)
SEED = 6


def data(
    scale: float = 1.0, stated: tuple[Polarimeter, ...] = (STATED,), records: int | None = None
) -> CalibrationInput:
    """Return the input of a calibration whose polarimeter sees turns by a scale, its feed turned by 10 deg and more."""
    payload, rng, angles = GeometryPayload.make(16, quiet_days=1.0), np.random.default_rng(SEED), turned_deg()
    epochs_us = SCENARIO.start_us + MINUTE_US * np.arange(len(angles))
    spacecraft = replace(payload.spacecraft, polarimeters=stated)
    seen = scale * angles @ np.array(line_of_sight(spacecraft, STATED)) + 0.8 + rng.normal(0.0, 0.07, len(angles))
    told = zip(epochs_us.tolist(), seen.tolist(), strict=True)
    start_us, stop_us = int(epochs_us[0]), int(epochs_us[-1]) + MINUTE_US
    request = CalibrationRequest(
        Window(start_us - 3_600_000_000, start_us), Window(start_us, stop_us), CalibrationMethod.GEOMETRY
    )
    measured = angles + rng.normal(0.0, 0.01, angles.shape)
    made = payload.data(noise_db=0.03)
    return replace(
        made,
        request=request,
        ephemeris=replace(made.ephemeris, track=None),
        references=(ReferenceSeries("star_tracker", epochs_us, measured, np.full(angles.shape, 0.01)),),
        quiet_references=(),
        spacecraft=spacecraft,
        polarization=tuple(PolarizationRecord("p", at_us, ratio_db(10.0, angle)) for at_us, angle in told)[:records],
    )


def test_nothing_is_checked_where_the_catalogue_uses_none() -> None:
    for stated in ((), (replace(STATED, used=False),)):
        assert polarimeter_checks(data(stated=stated), CONFIG) == ()
    assert polarimeter_checks(replace(data(), spacecraft=None), CONFIG) == ()
    assert polarimeter_quality(()) == {}
    assert polarimeter_warnings(()) == ()


def test_a_true_one_passes_in_silence_with_its_figures() -> None:
    checks = polarimeter_checks(data(), CONFIG)
    print(f"seed {SEED}", checks)
    assert [check.verdict for check in checks] == [MotionVerdict.CONSISTENT]
    assert polarimeter_warnings(checks) == ()
    figures = polarimeter_quality(checks)
    assert abs(figures["polarimeter_response"] - 1.0) < 4.0 * figures["polarimeter_response_sigma"]


@pytest.mark.parametrize("scale", [-1.0, 0.5, 2.0])
def test_a_wrong_one_is_refused_with_figures_and_the_next_step(scale: float) -> None:
    checks = polarimeter_checks(data(scale), CONFIG)
    (check,) = checks
    assert check.verdict is MotionVerdict.CONTRADICTED
    assert math.isclose(check.response, scale, abs_tol=0.15)
    (text,) = polarimeter_warnings(checks)
    assert text.startswith(f"polarimeter p is refused: its angle follows the turns by {check.response:+.2f}")
    assert "correct the sign of feed_offset_deg" in text


@pytest.mark.parametrize(
    ("records", "reason"), [(19, "19 records within the turns, 20 are needed"), (40, "too few turns")]
)
def test_too_little_is_not_checked_and_says_why(records: int, reason: str) -> None:
    checks = polarimeter_checks(data(records=records), CONFIG)
    assert [check.verdict for check in checks] == [MotionVerdict.UNCHECKED]
    assert reason in polarimeter_warnings(checks)[0]


def test_the_feed_is_told_with_its_leakage_whatever_the_catalogue_states() -> None:
    (check,), (other,) = (
        polarimeter_checks(data(stated=(replace(STATED, feed_offset_deg=at),)), CONFIG) for at in (10, 9)
    )
    assert check.feed is not None
    assert other.feed is not None
    sigma_deg = math.sqrt(check.feed.covariance[0][0])
    print(f"seed {SEED}", check.feed)
    assert check.feed.mean[0] == pytest.approx(10.8, abs=4.0 * sigma_deg)
    assert other.feed.mean == pytest.approx(check.feed.mean, abs=1e-3)
    figures = polarimeter_quality((check,))
    assert figures["polarimeter_feed_turn_deg"] == check.feed.mean[0]
    assert figures["polarimeter_feed_turn_sigma_deg"] == sigma_deg
    assert figures["polarimeter_leakage_sigma_deg"] == pytest.approx(0.72, abs=0.02)
    assert figures["polarimeter_daily_deg"] == pytest.approx(math.hypot(*check.feed.mean[1:]))


def test_a_feed_far_from_where_the_catalogue_puts_it_is_named_and_used() -> None:
    checks = polarimeter_checks(data(stated=(replace(STATED, feed_offset_deg=5.0),)), CONFIG)
    assert [check.verdict for check in checks] == [MotionVerdict.CONSISTENT]
    (text,) = polarimeter_warnings(checks)
    assert text.startswith("polarimeter p is used: its feed is turned by 11.0 +- 0.7 deg, the catalogue states 5;")


def test_angles_and_ratios_with_a_feed_of_their_own_tell_nothing_of_a_feed() -> None:
    made = data()
    own = tuple(replace(one, feed_offset_deg=10.0) for one in made.polarization)
    angles = tuple(replace(one, ratio_db=None, angle_deg=angle_deg(10.0, one.ratio_db or 0.0)) for one in own)
    for records in (own, angles):
        (check,) = polarimeter_checks(replace(made, polarization=records), CONFIG)
        assert (check.verdict, check.feed) == (MotionVerdict.CONSISTENT, None)
