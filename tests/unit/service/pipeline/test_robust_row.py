"""Rows of the robust method: why a carrier is out, why control is not allowed, what the row says beside angles."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import Flight, FlightPayload

from service.core.estimation.filtering.integrity import Evidence, Integrity, IntegrityLimits, assess
from service.pipeline.interlock import INHIBITIONS
from service.pipeline.robust_row import filtered_row
from service.records.attitude import Status
from service.records.calibration import SensorSigns
from service.records.inputs import Operation

PAYLOAD = FlightPayload.make()
NAN = float("nan")


def on(*carriers, by=1.0):
    """Return a change of some carriers (N,) by some decibel."""
    return by * np.isin(np.arange(16), carriers)


def reasons(row):
    return {item.carrier: item.reason for item in row.excluded}


@pytest.fixture
def flight():
    """A chain that has run for half an hour."""
    flight = Flight(PAYLOAD)
    flight.run(range(1, 31))
    return flight


def test_an_absent_carrier(flight):
    row = flight.run([31], np.where(np.arange(16) == 6, NAN, 0.0))[0]
    assert reasons(row) == {"c06": "absent"}
    assert row.carriers_used == 15


@pytest.mark.parametrize(("by", "reason"), [(-2.0, "uplink_fade"), (2.0, "interference")])
def test_a_carrier_that_jumps_is_out_at_once_with_the_sign_as_reason(flight, by, reason):
    assert reasons(flight.run([31], on(3, by=by))[0]) == {"c03": reason}


def test_a_carrier_that_stays_at_another_level_is_a_step(flight):
    rows = flight.run(range(31, 60), on(3, by=-2.0))
    assert reasons(rows[3]) == {"c03": "uplink_fade"}
    assert reasons(rows[20]) == {"c03": "step"}
    np.testing.assert_allclose([flight.error_deg(row) for row in rows], 0.0, atol=0.01)


@pytest.mark.parametrize(("sign", "reason"), [(-1.0, "uplink_fade"), (1.0, "interference")])
def test_a_flagged_carrier_that_is_restless_is_rain_below_and_interference_above(flight, sign, reason):
    rng = np.random.default_rng(6)
    rows = [flight.run([minute], on(3, by=sign * (3.0 + rng.normal())))[0] for minute in range(31, 60)]
    assert reasons(rows[25]) == {"c03": reason}


def test_a_transponder_all_of_whose_carriers_are_out_is_a_group(flight):
    members = [k for k, name in enumerate(PAYLOAD.transponders) if name == "Ku1"]
    change = sum(on(k, by=by) for k, by in zip(members, (3.0, -4.0, 5.0, -6.0), strict=True))
    rows = flight.run(range(31, 50), change)
    assert reasons(rows[10]) == dict.fromkeys((f"c{k:02d}" for k in members), "group")
    np.testing.assert_allclose(flight.error_deg(rows[-1])[1:], 0.0, atol=0.02)


def test_a_declared_mask_is_manual_whatever_the_carrier_does(flight):
    flight.chain.learn(Operation(1, "carrier_work", flight.at(31), flight.at(40), ("c02", "c05")))
    change = np.where(np.arange(16) == 5, NAN, on(2, by=-9.0))
    assert reasons(flight.run([32], change)[0]) == {"c02": "manual", "c05": "manual"}


def test_a_carrier_that_the_method_does_not_use_is_not_excluded_but_absent_from_the_account():
    flight = Flight(PAYLOAD)
    used = (True,) * 15 + (False,)
    flight.documents.calibrations[1] = PAYLOAD.calibration(is_used=used)
    for content in flight.opening():
        flight.chain.learn(content)
    row = flight.run([1], on(15, by=9.0))[0]
    assert (row.excluded, row.carriers_used) == ((), 15)


def test_rain_over_the_receiving_site_is_told_with_its_depth(flight):
    depth = -0.1 * np.arange(30)
    share = np.where(PAYLOAD.band() == 1, 1.0, 0.1)
    rows = [flight.run([31 + k], fall * share)[0] for k, fall in enumerate(depth)]
    assert rows[-1].downlink_fade
    assert "downlink_fade" in rows[-1].inhibitions
    assert rows[-1].downlink_fade_db == pytest.approx(2.9, abs=0.2)
    assert (rows[0].downlink_fade, rows[0].downlink_fade_db) == (False, 0.0)
    np.testing.assert_allclose(flight.error_deg(rows[-1])[1:], 0.0, atol=0.05)


def test_beyond_the_range_of_the_model_nothing_is_controlled_and_of_yaw_alone_only_yaw_is_not():
    far = Flight(PAYLOAD, (0.0, 0.0, 0.45))
    row = far.run([1])[0]
    assert row.inhibitions == ("beyond_validity",)
    assert row.control_allowed_axes == (False, False, False)
    turned = Flight(PAYLOAD, (2.2, 0.0, 0.0)).run([1])[0]
    assert turned.inhibitions == ()
    assert turned.control_allowed_axes == (False, True, True)
    assert Flight(PAYLOAD, (0.8, 0.0, 0.0)).run([1])[0].control_allowed_axes == (True, True, True)


@pytest.mark.parametrize(
    ("signs", "is_allowed"), [(None, True), (SensorSigns(True, False), True), (SensorSigns(False, True), False)]
)
def test_yaw_whose_sign_the_calibration_left_unproven_is_not_controlled(signs, is_allowed):
    flight = Flight(PAYLOAD, is_opened=False)
    calibration = flight.documents.calibrations[1]
    flight.documents.calibrations[1] = replace(calibration, result=replace(calibration.result, signs=signs))
    for content in flight.opening():
        flight.chain.learn(content)
    row = flight.run(range(1, 31))[-1]
    assert row.control_allowed
    assert row.control_allowed_axes == (is_allowed, True, True)


def test_rows_that_are_caught_up_with_say_so(flight):
    row = flight.robust(flight.row(31, is_late=True), is_catch_up=True)
    assert (row.inhibitions, row.control_allowed) == (("catch_up",), False)
    np.testing.assert_allclose(flight.error_deg(row), 0.0, atol=0.01)


def test_an_operation_that_forbids_control_is_named(flight):
    flight.chain.learn(Operation(1, "other", flight.at(31), None, inhibit_control=True))
    assert flight.run([31])[0].inhibitions == ("operation",)


def test_realignment_is_advised_when_many_references_were_learned_anew(flight):
    assert flight.run([31])[0].advice == ()
    for minute in range(32, 150):
        steps = sum(on(k, by=2.0 * (-1) ** k) for k in range(7) if minute >= 32 + 6 * k)
        row = flight.run([minute], steps)[0]
        if row.advice:
            break
    # six of sixteen are more than a third
    assert 32 + 30 + 5 * 6 <= minute < 149
    np.testing.assert_allclose(flight.error_deg(row)[1:], 0.0, atol=0.02)
    assert row.control_allowed
    assert row.advice == ("realign",)


def test_every_reason_of_integrity_forbids_control_and_is_explained(flight, monkeypatch):
    captured = {}

    def spy(*args, **options):
        captured["args"], captured["options"] = args, options
        return filtered_row(*args, **options)

    monkeypatch.setattr("service.pipeline.robust_method.filtered_row", spy)
    flight.run([31])
    measurement, model, fixed = captured["args"]
    worst = Evidence(np.full(3, NAN), 0, True, True, 1e9, (True, True, True), 16, 16)
    worst = worst._replace(**{name: True for name in Evidence._fields if name.startswith("is_command")})
    every = assess(worst, IntegrityLimits())
    for reason in every.reasons:
        verdict = Integrity(False, (False, False, False), (reason,), False)
        told = replace_told(fixed, verdict)
        row = filtered_row(measurement, model, told, **captured["options"])
        assert row.inhibitions == (reason,)
        assert not row.control_allowed
    unnamed = Integrity(False, (False, False, False), ("of_tomorrow", "sigma_roll"), False)
    row = filtered_row(measurement, model, replace_told(fixed, unnamed), **captured["options"])
    assert row.inhibitions == ("sigma_roll", "of_tomorrow")
    assert set(every.reasons) <= set(INHIBITIONS)


def replace_told(fixed, verdict):
    return fixed._replace(told=fixed.told._replace(integrity=verdict))


def test_a_good_row_tells_everything(flight):
    row = flight.run([31])[0]
    assert row.status is Status.ACQUIRED
    assert (row.control_allowed, row.control_allowed_axes, row.inhibitions) == (True, (True, True, True), ())
    assert (row.carriers_used, row.excluded, row.advice) == (16, (), ())
    assert (row.calibration_id, row.alignment_id) == (1, 1)
    assert row.number == flight.row(31).number
    assert row.residual_rms_db < 0.01
    np.testing.assert_allclose(row.rates_deg_s, 0.0, atol=2e-6)
    assert np.isfinite(row.sigma_deg).all()
