"""Harmonics of any window and the recommended carriers."""

import math

import numpy as np
import pytest

from service.records.attitude import Axes
from service.records.epoch import format_epoch

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
    told = await bench.get("/harmonics", **window)
    assert (told["range"], told["method"], told["rows"]) == (window, "paper", 288)
    assert (told["plan_id"], told["ephemeris_id"]) == (1, 1)
    for k, fit in enumerate(told["carriers"][:5]):
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
    absent = told["carriers"][5]
    assert (absent["amplitude_db"], absent["phase_sigma_rad"], absent["samples_used"]) == (None, None, 0)
    (one,) = (await bench.get("/harmonics", **window, carrier="c02"))["carriers"]
    assert (one["carrier"], one["samples_used"]) == ("c02", told["carriers"][2]["samples_used"])
    # sums over one column and over six are taken in another order
    assert one["amplitude_db"] == pytest.approx(told["carriers"][2]["amplitude_db"], rel=1e-12)


async def test_window_without_rows_has_no_harmonic(bench):
    told = await bench.get("/harmonics", start="2026-11-01T00:00:00Z", stop="2026-11-02T00:00:00Z")
    assert told["rows"] == 0
    assert [fit["amplitude_db"] for fit in told["carriers"]] == [None] * 6


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
    told = await bench.get("/carrier-selection", count=3)
    assert told["selected"] == ["c00", "c01", "c02"], "roll, pitch and yaw take turns"
    assert (told["rule"], told["count"], told["calibration_id"]) == ("paper", 3, 1)
    assert [row["axis"] for row in told["carriers"]] == ["roll", "pitch", "yaw", "roll", "roll", None]
    assert [row["rank"] for row in told["carriers"]] == [0, 1, 2, None, None, None]
    assert [row["selected"] for row in told["carriers"]] == [True, True, True, False, False, False]
    assert told["carriers"][0]["dominance"] == 10.0
    assert told["carriers"][0]["reasons"] == [
        "chosen for roll: answers 10.00 times more to roll than to any other axis"
    ]
    assert told["carriers"][3]["reasons"] == [
        "answers 1.11 times more to roll than to any other axis; 3 carriers before it do more"
    ]
    assert told["carriers"][4]["reasons"] == ["not stable: rms 0.090 dB"]
    assert told["carriers"][5]["reasons"] == ["the calibration has no sensitivity of it for every axis"]
    assert told["carriers"][5]["sensitivity_db_per_deg"] == {"yaw": None, "roll": None, "pitch": None}
    sensitivity = np.array([[0.0, 2.0, 0.2], [0.02, 0.3, 1.8], [0.25, 0.3, 0.2]])
    dop = np.sqrt(np.diag(np.linalg.inv(sensitivity.T @ sensitivity)))
    # the oracle inverts the normal matrix, the service goes by QR; both are good to 1e-9 at a condition of 8
    assert list(told["dop"].values()) == pytest.approx(dop.tolist(), rel=1e-9)
    assert told["condition"] == pytest.approx(np.linalg.cond(sensitivity), rel=1e-9)
    assert told["crlb_deg"] == {"yaw": None, "roll": None, "pitch": None}, "three carriers cannot tell a common level"
    assert len((await bench.get("/carrier-selection"))["selected"]) == 4, "no more than there are"


async def test_carrier_that_the_plan_excludes_is_not_recommended(bench, make):
    plan = bench.storage.catalogue.put_plan(
        make.sc, [make.carrier(0, uplink_power_control="auto"), make.carrier(1), make.carrier(2)], "second"
    )
    assert plan.id == 2
    carriers = [make.carrier_calibration(k, Axes(0.1 * k, 1.0, 0.5 * k)) for k in range(3)]
    results = bench.storage.results
    bench.calibrate(carriers, is_active=False)
    first = results.calibration(make.sc, 1)
    draft = results.add_calibration(make.sc, first.request, plan.id, 1, make.now_us, "engineer")
    results.finish_calibration(make.sc, draft.id, first.result, None)
    told = await bench.get("/carrier-selection")
    assert (told["calibration_id"], told["selected"]) == (2, ["c01", "c02"])
    assert told["carriers"][0]["reasons"] == [
        "not usable for attitude: disabled, a beacon, or under uplink power control"
    ]
    assert told["condition"] is None, "infinite: two carriers do not determine three angles"
