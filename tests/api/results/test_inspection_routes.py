"""Harmonics of any window, and recommended carriers."""

import math
from dataclasses import replace

import numpy as np
import pytest

from service.core.geometry.line_of_sight import Positions, sight_motion_deg, track_position_deg
from service.core.geometry.line_of_sight import PredictedTrack as CoreTrack
from service.records.calibration import CalibrationMethod
from service.records.catalogue import Track
from service.records.epoch import format_epoch
from service.records.levels.attitude import Axes

pytestmark = pytest.mark.anyio


SC = "/spacecraft/yamal-202"
PERIOD_S = 86_328.0


async def test_harmonic_of_a_window_is_found(bench, make):
    seed = 7
    print("seed", seed)
    rng = np.random.default_rng(seed)
    epochs_us = make.now_us - np.arange(1, 289) * 300 * make.s
    node_us = make.now_us
    phase_rad = 2 * np.pi * (epochs_us - node_us) / (PERIOD_S * make.s)
    amplitude_db, phi_rad = np.array([0.35, 0.2, 0.5, 0.1, 0.3, 0.4]), np.array([-0.6, 1.0, 2.0, -2.0, 0.3, 3.0])
    sigma_db = 0.02
    power_dbm = -42.0 + amplitude_db * np.cos(phase_rad[:, None] + phi_rad) + rng.normal(0, sigma_db, (288, 6))
    power_dbm[:, 5] = math.nan
    bench.append([int(epoch_us) for epoch_us in epochs_us], power_dbm)
    window = {"start": format_epoch(make.now_us - 86_400 * make.s), "stop": format_epoch(make.now_us)}
    reported = await bench.get("/harmonics", **window)
    assert (reported["range"], reported["method"], reported["rows"]) == (window, "paper", 288)
    assert (reported["plan_id"], reported["ephemeris_id"]) == (1, 1)
    for k, fit in enumerate(reported["carriers"][:5]):
        assert fit["carrier"] == f"c{k:02d}"
        # five standard errors of 288 samples: sigma sqrt(2 / 288) = 0.0017 dB
        assert fit["amplitude_db"] == pytest.approx(amplitude_db[k], abs=0.0085)
        assert fit["phase_rad"] == pytest.approx(phi_rad[k], abs=0.0085 / amplitude_db[k])
        assert fit["offset_dbm"] == pytest.approx(-42.0, abs=0.006)
        # the sigma of a sigma from 288 samples is four percent; orthogonality over the window is not perfect
        expected_db = sigma_db * math.sqrt(2 / 288)
        assert fit["amplitude_sigma_db"] == pytest.approx(expected_db, rel=0.2)
        assert fit["phase_sigma_rad"] == pytest.approx(expected_db / amplitude_db[k], rel=0.2)
        assert fit["offset_sigma_db"] == pytest.approx(sigma_db / math.sqrt(288), rel=0.2)
        assert fit["converged"] is True
        assert fit["samples_used"] + fit["samples_rejected"] == 288
        assert fit["node_epoch"] == format_epoch(make.now_us - 86_328 * make.s)
    absent = reported["carriers"][5]
    assert (absent["amplitude_db"], absent["phase_sigma_rad"], absent["samples_used"]) == (None, None, 0)
    (one,) = (await bench.get("/harmonics", **window, carrier="c02"))["carriers"]
    assert (one["carrier"], one["samples_used"]) == ("c02", reported["carriers"][2]["samples_used"])
    # sums over one column and over six are taken in another order
    assert one["amplitude_db"] == pytest.approx(reported["carriers"][2]["amplitude_db"], rel=1e-12)


async def test_window_without_rows_has_no_harmonic(bench):
    reported = await bench.get("/harmonics", start="2026-11-01T00:00:00Z", stop="2026-11-02T00:00:00Z")
    assert reported["rows"] == 0
    assert [fit["amplitude_db"] for fit in reported["carriers"]] == [None] * 6


async def test_robust_fit_survives_what_spoils_the_published_one(bench, make):
    """Two harmonics under noise, and 40 % of one carrier 3 dB down: no track, so no dish law."""
    seed = 11
    print("seed", seed)
    rng = np.random.default_rng(seed)
    epochs_us = make.now_us - np.arange(1, 577) * 300 * make.s
    angle = 2 * np.pi * (epochs_us - make.now_us) / (PERIOD_S * make.s)
    wave_db = 0.35 * np.cos(angle - 0.6) + 0.2 * np.cos(2 * angle + 1.1)
    power_dbm = -42.0 + wave_db[:, None] + rng.normal(0, 0.02, (576, 6))
    power_dbm[100:330, 1] -= 3.0
    bench.append([int(epoch_us) for epoch_us in epochs_us], power_dbm)
    window = {"start": format_epoch(make.now_us - 2 * 86_400 * make.s), "stop": format_epoch(make.now_us)}
    reported = await bench.get("/harmonics", **window, method="robust")
    assert (reported["method"], reported["rows"]) == ("robust", 576)
    for fit in reported["carriers"]:
        # five standard errors of 346 good samples: 0.02 sqrt(2 / 346) = 0.0015 dB, one third more for the holes
        assert fit["amplitude_db"] == pytest.approx(0.35, abs=0.010)
        assert fit["phase_rad"] == pytest.approx(-0.6, abs=0.010 / 0.35)
        assert fit["second_amplitude_db"] == pytest.approx(0.2, abs=0.010)
        assert fit["second_phase_rad"] == pytest.approx(1.1, abs=0.010 / 0.2)
        assert fit["offset_dbm"] == pytest.approx(-42.0, abs=0.007)
        # a standard deviation of 346 samples is good to 4 %
        assert fit["rms_db"] == pytest.approx(0.02, rel=0.15)
        assert (fit["law"], fit["dish_law"], fit["converged"]) == ("two_harmonics", None, True)
    spoiled, clean = reported["carriers"][1], reported["carriers"][0]
    # all 230 faded samples and at most 1 % of the good ones
    assert 230 <= spoiled["samples_rejected"] <= 236
    assert clean["samples_rejected"] <= 6
    paper = (await bench.get("/harmonics", **window, carrier="c01"))["carriers"][0]
    assert (paper["law"], paper["second_amplitude_db"]) == ("one_harmonic", None)
    assert abs(paper["offset_dbm"] + 42.0) > 0.5, "the published fit follows the fade"


async def test_robust_fit_takes_the_dish_law_where_ballistics_has_a_track(bench, make):
    """Powers made by the dish law along the track come back as its coefficients, to rounding of float32."""
    epochs_us = make.now_us - np.arange(1, 289) * 300 * make.s
    track_us = make.now_us + np.arange(-60, 3) * 1800 * make.s
    angle = 2 * np.pi * (track_us - make.now_us) / (PERIOD_S * make.s)
    track = Track(
        tuple(track_us.tolist()),
        tuple((0.05 * np.sin(angle)).tolist()),
        tuple((90.0 + 0.02 * np.cos(angle)).tolist()),
    )
    storage = bench.storage
    known = storage.catalogue.ephemeris(make.sc)
    storage.catalogue.put_ephemeris(make.sc, replace(known, form="nodes", track=track))
    carriers = storage.catalogue.plan(make.sc).carriers
    positions = Positions(
        np.array([c.station.latitude_deg for c in carriers]),
        np.array([c.station.longitude_deg for c in carriers]),
        np.zeros(len(carriers)),
    )
    core_track = CoreTrack(track_us, np.array(track.latitude_deg), np.array(track.longitude_deg))
    motion = sight_motion_deg(track_position_deg(core_track, epochs_us), positions, 90.0)
    power_dbm = -45.0 + 3.0 * motion[..., 0] - 2.0 * motion[..., 1] - 60.0 * np.square(motion).sum(axis=-1)
    bench.append([int(epoch_us) for epoch_us in epochs_us], power_dbm)
    reported = await bench.get(
        "/harmonics",
        start=format_epoch(make.now_us - 86_400 * make.s),
        stop=format_epoch(make.now_us),
        method="robust",
    )
    for fit in reported["carriers"]:
        assert fit["law"] == "dish_law"
        # float32 of 45 dBm has steps of 4e-6 dB; motion is 0.05 deg, its square 0.0025: gains of 20 and 400
        assert fit["dish_law"]["b1_db_per_deg"] == pytest.approx(3.0, abs=1e-3)
        assert fit["dish_law"]["b2_db_per_deg"] == pytest.approx(-2.0, abs=1e-3)
        assert fit["dish_law"]["k_db_per_deg2"] == pytest.approx(60.0, abs=0.02)
        # a square of a wave of 0.05 deg: 60 * 0.0025 / 2 dB at twice the frequency, less what longitude takes
        assert 0.02 < fit["second_amplitude_db"] < 0.08
        assert fit["amplitude_db"] > 0.05


async def test_recommended_carriers_with_their_reasons(bench, make):
    carriers = [
        make.carrier_calibration(0, Axes(0.0, 2.0, 0.2)),
        make.carrier_calibration(1, Axes(0.02, 0.3, 1.8)),
        make.carrier_calibration(2, Axes(0.25, 0.3, 0.2)),
        make.carrier_calibration(3, Axes(0.0, 1.0, 0.9)),
        make.carrier_calibration(4, Axes(0.0, 3.0, 0.1), criteria_met=("linear", "dominant")),
        make.carrier_calibration(5, Axes(make.nan, make.nan, make.nan), criteria_met=()),
    ]
    bench.calibrate(carriers, is_active=False)
    reported = await bench.get("/carrier-selection", count=5)
    assert reported["selected"] == ["c00", "c01", "c02", "c03"], "roll, pitch and yaw take turns, and there are no more"
    assert (reported["rule"], reported["count"], reported["calibration_id"]) == ("paper", 5, 1)
    assert [row["axis"] for row in reported["carriers"]] == ["roll", "pitch", "yaw", "roll", "roll", None]
    assert [row["rank"] for row in reported["carriers"]] == [0, 1, 2, 3, None, None]
    assert [row["selected"] for row in reported["carriers"]] == [True, True, True, True, False, False]
    assert reported["carriers"][0]["dominance"] == 10.0
    assert reported["carriers"][0]["reasons"] == [
        "chosen for roll: answers 10.00 times more to roll than to any other axis"
    ]
    assert reported["carriers"][4]["reasons"] == ["not stable: rms 0.090 dB"]
    assert reported["carriers"][5]["reasons"] == ["the calibration has no sensitivity of it for every axis"]
    assert reported["carriers"][5]["sensitivity_db_per_deg"] == {"yaw": None, "roll": None, "pitch": None}
    assert reported["carriers"][0]["sigma_db"] == pytest.approx(math.hypot(0.03, 0.04), rel=1e-12)
    sensitivity = np.array([[0.0, 2.0, 0.2], [0.02, 0.3, 1.8], [0.25, 0.3, 0.2], [0.0, 1.0, 0.9]])
    dop = np.sqrt(np.diag(np.linalg.inv(sensitivity.T @ sensitivity)))
    # the oracle inverts the normal matrix, the service goes by QR; both are good to 1e-9 at a condition of 10
    assert list(reported["dop"].values()) == pytest.approx(dop.tolist(), rel=1e-9)
    assert reported["condition"] == pytest.approx(np.linalg.cond(sensitivity), rel=1e-9)
    design = np.column_stack([sensitivity, np.ones(4)])
    bound = 0.05 * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))[:3]
    assert list(reported["crlb_deg"].values()) == pytest.approx(bound.tolist(), rel=1e-9)
    assert not reported["sufficient"]
    assert any("at least 12" in text for text in reported["shortcomings"])
    assert any("yaw look better than it is" in text for text in reported["notes"])
    everything = (await bench.get("/carrier-selection"))["sets"]["all"]["selected"]
    assert everything == ["c00", "c01", "c02", "c03", "c04"], "the unstable one is usable, only not by the paper's rule"


async def test_optimal_carriers_beside_the_other_sets(bench, make):
    """Twenty carriers on four transponders; every figure of each set against the formulas."""
    seed = 29
    print("seed", seed)
    rng = np.random.default_rng(seed)
    sensitivity = rng.normal(0.0, [0.16, 1.4, 1.2], (20, 3))
    plan = bench.storage.catalogue.put_plan(
        make.sc, [make.carrier(k, transponder=f"Ku{k % 4}") for k in range(20)], "twenty"
    )
    bench.calibrate(
        [make.carrier_calibration(k, Axes(*sensitivity[k].tolist())) for k in range(20)],
        is_active=False,
        plan_id=plan.id,
        method=CalibrationMethod.GEOMETRY,
    )
    reported = await bench.get("/carrier-selection", count=12, rule="optimal", turns="far_yaw")
    assert (reported["rule"], reported["calibration_method"], reported["notes"]) == ("optimal", "geometry", [])
    assert (reported["sufficient"], reported["shortcomings"], len(reported["selected"])) == (True, [], 12)
    ranked = sorted((row["rank"], row["carrier"]) for row in reported["carriers"] if row["selected"])
    assert [name for _, name in ranked] == reported["selected"]
    for name, count in (("optimal", 12), ("paper", 12), ("all", 20)):
        found = reported["sets"][name]
        chosen = [int(carrier.removeprefix("c")) for carrier in found["selected"]]
        assert len(chosen) == count
        design = np.column_stack([sensitivity[chosen], np.ones(count)])
        covariance = 0.05**2 * np.linalg.inv(design.T @ design)
        # formulas invert the normal matrix at a condition of about 1e3
        bound = np.sqrt(np.diag(covariance))[:3]
        assert list(found["crlb_deg"].values()) == pytest.approx(bound.tolist(), rel=1e-9)
        assert found["redundancy"] == count - 5
        assert [row["span_s"] for row in found["averaged"]] == [900.0, 3600.0, 14_400.0, 43_200.0]
        x = 3.0
        kept = 0.03**2 / 60 + 0.04**2 * 2 * (x - 1 + math.exp(-x)) / x**2
        hour = bound * math.sqrt(kept) / 0.05
        assert list(found["averaged"][1]["sigma_deg"].values()) == pytest.approx(hour.tolist(), rel=1e-9)
        assert 0.0 < found["common_share"] < 1.0
        assert found["transponder_share"] <= 0.35 + 0.1 * (name == "paper")
    assert reported["sets"]["optimal"]["transponder_share"] <= 0.35
    first = next(row for row in reported["carriers"] if row["rank"] == 0)
    assert first["reasons"][0].startswith("chosen: without it bounds of yaw +")
    left = next(row for row in reported["carriers"] if not row["selected"])
    assert left["reasons"][0].startswith("as one more it would give bounds of yaw -")
    assert reported["turns"]["total_s"] == 8.5 * 3600
    assert max(step["yaw_deg"] for step in reported["turns"]["steps"]) == 1.0
    assert reported["turns"]["steps"][1]["offset_s"] == 900.0


async def test_active_calibration_by_geometry_judges_before_a_newer_draft(bench, make):
    carriers = [make.carrier_calibration(k, Axes(0.1 * k, 1.0, 0.5 * k)) for k in range(6)]
    bench.calibrate(carriers, method=CalibrationMethod.GEOMETRY)
    bench.calibrate(carriers, is_active=False)
    assert (await bench.get("/carrier-selection"))["calibration_id"] == 1


async def test_count_that_cannot_be_met(bench, make):
    bench.calibrate([make.carrier_calibration(k, Axes(0.1 * k, 1.0, 0.5 * k)) for k in range(6)], is_active=False)
    path = f"{SC}/carrier-selection?rule=optimal&count="
    assert await bench.refused("GET", path + "7") == (422, "selection.count", [])
    assert await bench.refused("GET", path + "4") == (422, "value.range", ["/query/count"])
    assert (await bench.get("/carrier-selection", rule="optimal"))["count"] == 6, "all when there are fewer than 16"


async def test_carriers_that_the_plan_excludes_are_too_few(bench, make):
    plan = bench.storage.catalogue.put_plan(
        make.sc, [make.carrier(k, uplink_power_control="auto" if k < 3 else "none") for k in range(6)], "second"
    )
    assert plan.id == 2
    carriers = [make.carrier_calibration(k, Axes(0.1 * k, 1.0, 0.5 * k)) for k in range(6)]
    bench.calibrate(carriers, is_active=False, plan_id=plan.id)
    assert await bench.refused("GET", f"{SC}/carrier-selection") == (409, "selection.too_few", [])


async def test_carrier_that_the_plan_excludes_is_not_recommended(bench, make):
    plan = bench.storage.catalogue.put_plan(
        make.sc, [make.carrier(k, uplink_power_control="auto" if k == 0 else "none") for k in range(6)], "third"
    )
    carriers = [make.carrier_calibration(k, Axes(0.1 * k * k, 1.0, 0.5 * k)) for k in range(6)]
    bench.calibrate(carriers, is_active=False, plan_id=plan.id)
    for rule in ("paper", "optimal"):
        reported = await bench.get("/carrier-selection", rule=rule)
        assert sorted(reported["selected"]) == ["c01", "c02", "c03", "c04", "c05"]
        assert reported["carriers"][0]["reasons"] == [
            "not usable for attitude: disabled, a beacon, or under uplink power control"
        ]


async def test_the_newest_plan_says_who_is_still_there(bench, make):
    """A plan changed since the calibration: one user gone, one disabled, one new."""
    bench.calibrate([make.carrier_calibration(k, Axes(0.1 * k * k, 1.0 - 0.1 * k, 0.5 * k)) for k in range(6)])
    bench.storage.catalogue.put_plan(make.sc, [make.carrier(k, enabled=k != 2) for k in range(1, 7)], "changed")
    reported = await bench.get("/carrier-selection", rule="optimal")
    assert sorted(reported["selected"]) == ["c01", "c03", "c04", "c05"]
    assert reported["carriers"][0]["reasons"] == ["no longer in the carrier plan"]
    assert "disabled" in reported["carriers"][2]["reasons"][0]
    assert "c06 were added by plan 2 after the calibration and are not calibrated" in reported["notes"]


async def test_carriers_that_do_not_determine_the_attitude(bench, make):
    """Six carriers that answer to one mixture: nothing but the reason is told."""
    bench.calibrate([make.carrier_calibration(k, Axes(0.1, 1.0, 0.5)) for k in range(6)], is_active=False)
    reported = await bench.get("/carrier-selection", rule="optimal")
    assert reported["crlb_deg"] == reported["dop"] == {"yaw": None, "roll": None, "pitch": None}
    assert reported["shortcomings"][0] == "the carriers do not determine three angles and a level common to all of them"
    assert reported["carriers"][0]["reasons"] == ["chosen: without it the attitude is not determined"]
