"""Looks at the archive on demand: harmonics of any window, and the carriers that a rule recommends.

Nothing is stored: an operator looks before deciding on a calibration or on which carriers to measure.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.core.estimation.observability import crlb_deg
from service.core.estimation.paper.harmonic import HarmonicFits, fit_harmonics
from service.core.estimation.paper.selection import AxisSelection, SelectionReason, select_by_axis
from service.core.geometry.node_phase import latest_node_us, node_phase_rad
from service.errors import ConflictError, NotFoundError
from service.pipeline.config import CalibrationConfig
from service.ports import Storage
from service.records.attitude import Axes, named_axes
from service.records.calibration import Calibration, CarrierCalibration, Harmonic, Window
from service.records.catalogue import CarrierPlan

_AXIS_NAMES = ("yaw", "roll", "pitch")


class CarrierHarmonic(NamedTuple):
    """Harmonic of one carrier in a window; sigmas hold for independent residuals."""

    carrier: str
    harmonic: Harmonic
    amplitude_sigma_db: float
    phase_sigma_rad: float
    offset_sigma_db: float
    #: whether the rejection of outliers came to rest
    is_converged: bool


class WindowHarmonics(NamedTuple):
    """Harmonics of a window under the newest ephemeris."""

    plan_id: int
    ephemeris_id: int
    #: measurements in the window
    rows: int
    carriers: tuple[CarrierHarmonic, ...]


@dataclass(frozen=True, slots=True)
class RecommendedCarrier:
    """What a rule says about one carrier."""

    carrier: str
    is_selected: bool
    #: place in the order of choice, 0 = first; None when it was not chosen
    rank: int | None
    #: axis it was chosen for, else the one it answers to most; None when not measured
    axis: str | None
    dominance: float
    sensitivity_db_per_deg: Axes
    residual_rms_db: float
    nonlinearity_deg: float
    reasons: tuple[str, ...]


class CarrierRecommendation(NamedTuple):
    """A recommended subset and what it can see."""

    calibration_id: int
    condition: float
    dop_deg_per_db: Axes
    #: one row, with a common-mode unknown
    crlb_deg: Axes
    carriers: tuple[RecommendedCarrier, ...]


def window_harmonics(
    storage: Storage, spacecraft_id: str, window: Window, carrier: str | None, config: CalibrationConfig
) -> WindowHarmonics:
    """Return the harmonics of a window for one carrier of the newest plan or for all.

    Raises
    ------
    NotFoundError
        ``carrier.unknown``; no carrier plan; no ephemeris.
    """
    plan = storage.catalogue.plan(spacecraft_id)
    ephemeris = storage.catalogue.ephemeris(spacecraft_id)
    names = _wanted_carriers(plan, carrier)
    series = storage.archive.measurement_series(spacecraft_id, window, names)
    nodes_us = np.array(ephemeris.ascending_nodes_us, dtype=np.int64)
    fits = fit_harmonics(
        node_phase_rad(series.epochs_us, nodes_us, ephemeris.nodal_period_s),
        series.power_dbm,
        max_iterations=config.harmonic.max_iterations,
        gate_sigma=config.harmonic.gate_sigma,
    )
    last_us = np.array([window.stop_us - 1]) if len(series.epochs_us) == 0 else series.epochs_us[-1:]
    node_us = int(latest_node_us(last_us, nodes_us, ephemeris.nodal_period_s)[0])
    carriers = tuple(_carrier_harmonic(k, n, fits, ephemeris.nodal_period_s, node_us) for k, n in enumerate(names))
    return WindowHarmonics(plan.id, ephemeris.id, len(series.epochs_us), carriers)


def recommend_carriers(
    storage: Storage, spacecraft_id: str, count: int, config: CalibrationConfig
) -> CarrierRecommendation:
    """Return the carriers that the paper's rule recommends by the newest calibration with figures.

    Raises
    ------
    ConflictError
        ``selection.no_calibration``: no calibration has figures yet.
    """
    calibration = _newest_with_result(storage, spacecraft_id)
    carriers = calibration.result.carriers if calibration.result else ()
    plan = storage.catalogue.plan(spacecraft_id, calibration.plan_id)
    usable = {carrier.id for carrier in plan.carriers if carrier.is_usable_for_attitude}
    symmetric = np.array([carrier.sensitivity_db_per_deg for carrier in carriers], dtype=np.float64).reshape(-1, 3)
    eligible = np.array([c.id in usable and {"stable", "linear"} <= set(c.criteria_met) for c in carriers], dtype=bool)
    choice = select_by_axis(symmetric, eligible, count, yaw_scale=config.criteria.yaw_scale)
    sigma_db = np.array([carrier.harmonic.rms_db for carrier in carriers], dtype=np.float64)
    return CarrierRecommendation(
        calibration.id,
        choice.condition,
        named_axes(choice.dilution_deg_per_db),
        named_axes(crlb_deg(symmetric[choice.chosen], sigma_db[choice.chosen], with_common=True)),
        tuple(_recommended(k, carrier, choice, usable) for k, carrier in enumerate(carriers)),
    )


def _wanted_carriers(plan: CarrierPlan, carrier: str | None) -> tuple[str, ...]:
    """Return the carriers to fit."""
    if carrier is None:
        return plan.carrier_ids
    if carrier not in plan.carrier_ids:
        detail = f"no carrier {carrier[:64]!r} in plan {plan.id}; its carriers are {', '.join(plan.carrier_ids)}"
        raise NotFoundError("carrier.unknown", detail)
    return (carrier,)


def _carrier_harmonic(k: int, name: str, fits: HarmonicFits, period_s: float, node_us: int) -> CarrierHarmonic:
    """Return the harmonic of the k-th carrier with its sigmas."""
    amplitude_db, phase_rad = float(fits.amplitude_db[k]), float(fits.phase_rad[k])
    # a1 = am cos phi, a2 = -am sin phi: an error along the vector (a1, a2) is one of am, across it one of phi
    along = np.array([0.0, np.cos(phase_rad), -np.sin(phase_rad)])
    across = np.array([0.0, np.sin(phase_rad), np.cos(phase_rad)])
    covariance = fits.covariance[k]
    harmonic = Harmonic(
        amplitude_db,
        phase_rad,
        float(fits.offset_dbm[k]),
        period_s,
        node_us,
        float(fits.rms_db[k]),
        int(fits.samples_used[k]),
        int(fits.samples_rejected[k]),
    )
    return CarrierHarmonic(
        name,
        harmonic,
        amplitude_sigma_db=float(np.sqrt(along @ covariance @ along)),
        phase_sigma_rad=float(np.sqrt(across @ covariance @ across)) / amplitude_db if amplitude_db else float("nan"),
        offset_sigma_db=float(np.sqrt(covariance[0, 0])),
        is_converged=bool(fits.converged[k]),
    )


def _newest_with_result(storage: Storage, spacecraft_id: str) -> Calibration:
    """Return the newest calibration that has figures."""
    for calibration in storage.results.calibrations(spacecraft_id):
        if calibration.result is not None:
            return calibration
    detail = f"no calibration of {spacecraft_id} has figures to choose carriers by; calibrate it first"
    raise ConflictError("selection.no_calibration", detail)


def _recommended(k: int, carrier: CarrierCalibration, choice: AxisSelection, usable: set[str]) -> RecommendedCarrier:
    """Return what the rule says about the k-th carrier."""
    axis, is_selected = int(choice.axis[k]), int(choice.rank[k]) >= 0
    return RecommendedCarrier(
        carrier=carrier.id,
        is_selected=is_selected,
        rank=int(choice.rank[k]) if is_selected else None,
        axis=_AXIS_NAMES[axis] if axis >= 0 else None,
        dominance=float(choice.dominance[k]),
        sensitivity_db_per_deg=carrier.sensitivity_db_per_deg,
        residual_rms_db=carrier.stability_residual_rms_db,
        nonlinearity_deg=carrier.nonlinearity_deg,
        reasons=_reasons(k, carrier, choice, len(choice.chosen), is_usable=carrier.id in usable),
    )


def _reasons(
    k: int, carrier: CarrierCalibration, choice: AxisSelection, chosen: int, *, is_usable: bool
) -> tuple[str, ...]:
    """Return why the k-th carrier was chosen or left out, with figures."""
    reason, axis = SelectionReason(int(choice.reason[k])), _AXIS_NAMES[int(choice.axis[k])]
    dominance = f"answers {choice.dominance[k]:.2f} times more to {axis} than to any other axis"
    if reason is SelectionReason.CHOSEN:
        return (f"chosen for {axis}: {dominance}",)
    if reason is SelectionReason.NOT_NEEDED:
        return (f"{dominance}; {chosen} carriers before it do more",)
    if reason is SelectionReason.NOT_MEASURED:
        return ("the calibration has no sensitivity of it for every axis",)
    texts = (
        (is_usable, "not usable for attitude: disabled, a beacon, or under uplink power control"),
        ("stable" in carrier.criteria_met, f"not stable: rms {carrier.stability_residual_rms_db:.3f} dB"),
        ("linear" in carrier.criteria_met, f"not linear: departs {carrier.nonlinearity_deg:.3f} deg"),
    )
    return tuple(text for is_met, text in texts if not is_met)
