"""Harmonic removal, L1 to L2: measured power minus reference minus the daily harmonic.

The phase is counted from the latest ascending node of the ephemeris that holds; references (``paper_alignment``) have
the harmonic removed, so it enters with h = 0. Refuses nothing: a carrier without a reference or without a level has the
deviation NaN.
"""

from dataclasses import dataclass

import numpy as np

from service.core.estimation.paper.harmonic import evaluate_harmonic
from service.core.geometry.line_of_sight import node_phase_at_rad, node_phase_rad
from service.pipeline.estimation.paper.snapshot_fix import answer_db, sensitivity_model
from service.records.calibration import Alignment, Calibration, CarrierReference
from service.records.catalogue import Ephemeris, Method
from service.records.levels.attitude import Deviation, FloatArray

#: instants over the alignment window at which two harmonics are compared when references are re-derived
_REDERIVE_INSTANTS = 60


@dataclass(frozen=True)
class ExpectedPower:
    """Expected power of every carrier of a calibration as a function of node phase."""

    carrier_ids: tuple[str, ...]
    #: (N,) dBm, harmonic removed; NaN = no reference
    reference_dbm: FloatArray
    #: (N,) dB
    amplitude_db: FloatArray
    #: (N,) rad
    phase_rad: FloatArray


def harmonic_arrays(calibration: Calibration) -> tuple[FloatArray, FloatArray]:
    """Return amplitude (N,) in dB and phase (N,) in rad of a finished calibration."""
    carriers = calibration.result.carriers if calibration.result else ()
    return (
        np.array([carrier.harmonic.amplitude_db for carrier in carriers]),
        np.array([carrier.harmonic.phase_rad for carrier in carriers]),
    )


def harmonic_db(calibration: Calibration, ephemeris: Ephemeris, epochs_us: FloatArray) -> FloatArray:
    """Return the harmonic of every carrier, shape (T, N) in dB, at some epochs."""
    amplitude_db, phase_rad = harmonic_arrays(calibration)
    nodes_us = np.array(ephemeris.ascending_nodes_us, dtype=np.int64)
    phase = node_phase_rad(epochs_us.astype(np.int64), nodes_us, ephemeris.nodal_period_s)
    return evaluate_harmonic(phase, amplitude_db, phase_rad)


def expected_power(
    calibration: Calibration,
    alignment: Alignment,
    method: Method,
    ephemeris: Ephemeris,
    aligned_with: Calibration,
) -> ExpectedPower:
    """Return references and harmonic for a calibration under an alignment.

    When another calibration was active at the alignment (``aligned_with``), each reference is moved by the mean
    difference of the two harmonics over the alignment window, and by that of the two changes at the angles of the
    alignment: the mean power there stays what it was.
    """
    carrier_ids = tuple(carrier.id for carrier in calibration.result.carriers) if calibration.result else ()
    references = {item.carrier: item.reference_dbm for item in references_of(alignment, method)}
    reference_dbm = np.array([references.get(carrier, np.nan) for carrier in carrier_ids])
    if aligned_with.id != calibration.id and alignment.window is not None:
        instants = np.linspace(alignment.window.start_us, alignment.window.stop_us, _REDERIVE_INSTANTS)
        old_ids = [carrier.id for carrier in aligned_with.result.carriers] if aligned_with.result else []
        old_db = dict(zip(old_ids, harmonic_db(aligned_with, ephemeris, instants).mean(axis=0), strict=True))
        new_db = harmonic_db(calibration, ephemeris, instants).mean(axis=0)
        turned = np.array([alignment.attitude_deg])
        turned_db = answer_db(sensitivity_model(aligned_with), turned)[0]
        old_db = {name: old_db[name] + float(turned_db[k]) for k, name in enumerate(old_ids)}
        new_db = new_db + answer_db(sensitivity_model(calibration), turned)[0]
        reference_dbm = reference_dbm + np.array([old_db.get(c, np.nan) for c in carrier_ids]) - new_db
    amplitude_db, phase_rad = harmonic_arrays(calibration)
    return ExpectedPower(carrier_ids, reference_dbm, amplitude_db, phase_rad)


def references_of(alignment: Alignment, method: Method) -> tuple[CarrierReference, ...]:
    """Return the reference powers that an alignment set for a method."""
    return alignment.references_by_method.get(method.value, alignment.references)


def remove_harmonic(power_dbm: FloatArray, epoch_us: int, expected: ExpectedPower, ephemeris: Ephemeris) -> Deviation:
    """Return the deviation of one row whose powers stand in the calibration's order of carriers."""
    phase = node_phase_at_rad(epoch_us, ephemeris.ascending_nodes_us, ephemeris.nodal_period_s)
    expected_dbm = expected.reference_dbm + evaluate_harmonic(phase, expected.amplitude_db, expected.phase_rad)
    return Deviation(epoch_us, expected_dbm, power_dbm - expected_dbm)
