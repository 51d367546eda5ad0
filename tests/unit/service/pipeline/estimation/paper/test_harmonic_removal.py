"""Harmonic removal: deviations of a payload whose harmonics are known, and references that follow a new calibration."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic_payload as synthetic

from service.core.estimation.paper.octants import predict_deviation_db
from service.pipeline.estimation.paper.harmonic_removal import (
    expected_power,
    harmonic_arrays,
    harmonic_db,
    references_of,
    remove_harmonic,
)
from service.records.calibration import CarrierReference
from service.records.catalogue import Method
from service.records.levels.attitude import Axes


@pytest.fixture
def at_us():
    """Instants over two nodal periods."""
    return synthetic.START_US + np.arange(0, 2 * synthetic.DAY, synthetic.DAY // 7)


def test_at_the_reference_attitude_nothing_is_left_at_any_phase(payload, at_us):
    alignment = payload.alignment(synthetic.START_US)
    calibration, ephemeris = payload.calibration(), payload.ephemeris()
    expected = expected_power(calibration, alignment, Method.PAPER, ephemeris, calibration)
    powers = payload.power_dbm(at_us, np.zeros(3))
    for epoch_us, power in zip(at_us.tolist(), powers, strict=True):
        deviation = remove_harmonic(power, epoch_us, expected, ephemeris)
        assert deviation.epoch_us == epoch_us
        # rounding of sums of 50 dBm
        np.testing.assert_allclose(deviation.deviation_db, 0.0, atol=1e-12)
        np.testing.assert_allclose(deviation.expected_dbm, power, atol=1e-12)


def test_absent_powers_and_carriers_without_reference_have_no_deviation(payload):
    alignment = payload.alignment(synthetic.START_US)
    alignment = replace(alignment, references=alignment.references[1:])
    calibration, ephemeris = payload.calibration(), payload.ephemeris()
    expected = expected_power(calibration, alignment, Method.PAPER, ephemeris, calibration)
    power = payload.power_dbm(np.array([synthetic.START_US]), np.zeros(3))[0]
    power[2] = np.nan
    deviation = remove_harmonic(power, synthetic.START_US, expected, ephemeris)
    assert np.flatnonzero(np.isnan(deviation.deviation_db)).tolist() == [0, 2]
    assert np.flatnonzero(np.isnan(deviation.expected_dbm)).tolist() == [0]


def test_harmonics_of_a_calibration_are_those_of_its_carriers(payload, at_us):
    amplitude, phase = harmonic_arrays(payload.calibration())
    np.testing.assert_array_equal(amplitude, payload.amplitude_db)
    np.testing.assert_array_equal(phase, payload.phase_rad)
    found = harmonic_db(payload.calibration(), payload.ephemeris(), at_us)
    # the same cosine, rounding only
    np.testing.assert_allclose(found, payload.harmonic_db(at_us), atol=1e-12)


def test_an_unfinished_calibration_has_no_harmonics(payload):
    amplitude, phase = harmonic_arrays(replace(payload.calibration(), result=None))
    assert (amplitude.size, phase.size) == (0, 0)


def test_a_new_calibration_keeps_the_mean_power_of_the_alignment_window(payload):
    old, alignment = payload.calibration(1), payload.alignment(synthetic.START_US + 5 * synthetic.HOUR)
    turned = replace(payload, amplitude_db=2.0 * payload.amplitude_db, phase_rad=payload.phase_rad + 1.0)
    new = turned.calibration(2)
    moved = expected_power(new, alignment, Method.PAPER, payload.ephemeris(), old)
    window_us = np.linspace(alignment.window.start_us, alignment.window.stop_us, 400)
    before = payload.level_dbm + harmonic_db(old, payload.ephemeris(), window_us).mean(axis=0)
    after = moved.reference_dbm + harmonic_db(new, payload.ephemeris(), window_us).mean(axis=0)
    # sixty instants against four hundred over a quarter of an hour of a daily wave
    np.testing.assert_allclose(after, before, atol=1e-4)
    assert np.abs(moved.reference_dbm - payload.level_dbm).max() > 0.05


def test_a_new_calibration_moves_references_by_the_change_at_the_angles_of_the_alignment(payload):
    old, angles = payload.calibration(1), np.array([0.2, -0.15, 0.2])
    new = replace(payload, plus=1.3 * payload.plus, minus=1.3 * payload.minus).calibration(2)
    made = payload.alignment(synthetic.START_US + synthetic.HOUR)
    alignment = replace(made, attitude_deg=Axes(*angles))
    moved = expected_power(new, alignment, Method.PAPER, payload.ephemeris(), old)
    change_db = predict_deviation_db(payload.plus, payload.minus, angles)
    # the power in the window is the same, and 1.3 times the change belongs to its angles now
    np.testing.assert_allclose(moved.reference_dbm - payload.level_dbm, -0.3 * change_db, atol=1e-12)


def test_a_carrier_that_the_former_calibration_did_not_have_gets_no_reference(payload):
    old = payload.calibration(1)
    old = replace(old, result=replace(old.result, carriers=old.result.carriers[1:]))
    alignment = payload.alignment(synthetic.START_US + synthetic.HOUR)
    found = expected_power(payload.calibration(2), alignment, Method.PAPER, payload.ephemeris(), old)
    assert np.flatnonzero(np.isnan(found.reference_dbm)).tolist() == [0]


def test_a_former_calibration_without_result_gives_no_reference_at_all(payload):
    old = replace(payload.calibration(1), result=None)
    alignment = payload.alignment(synthetic.START_US + synthetic.HOUR)
    found = expected_power(payload.calibration(2), alignment, Method.PAPER, payload.ephemeris(), old)
    assert np.isnan(found.reference_dbm).all()


def test_without_a_window_references_stay_as_they_are(payload):
    alignment = replace(payload.alignment(synthetic.START_US), window=None)
    found = expected_power(payload.calibration(2), alignment, Method.PAPER, payload.ephemeris(), payload.calibration(1))
    np.testing.assert_array_equal(found.reference_dbm, payload.level_dbm)


def test_an_unfinished_calibration_expects_nothing(payload):
    empty = replace(payload.calibration(1), result=None)
    found = expected_power(empty, payload.alignment(synthetic.START_US), Method.PAPER, payload.ephemeris(), empty)
    assert (found.carrier_ids, found.reference_dbm.size) == ((), 0)


def test_a_method_may_have_references_of_its_own(payload):
    own = (CarrierReference("c00", -1.0, 0.1, 9, 0.0),)
    alignment = replace(payload.alignment(synthetic.START_US), references_by_method={"robust": own})
    assert references_of(alignment, Method.ROBUST) == own
    assert references_of(alignment, Method.PAPER) == alignment.references
