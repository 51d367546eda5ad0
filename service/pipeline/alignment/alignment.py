"""Alignment: outside angles and the powers of the same minutes become the references of every method."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from service.core.estimation.paper.downlink_fade import Consistency
from service.pipeline.alignment.paper_references import reference_powers
from service.pipeline.alignment.robust_references import robust_references
from service.pipeline.config import AlignmentConfig
from service.pipeline.inputs.sensor_angles import StatedAngles
from service.records.calibration import (
    Alignment,
    Calibration,
    CalibrationMethod,
    CarrierReference,
    Window,
)
from service.records.catalogue import Ephemeris, Method
from service.records.levels.measurement import MeasurementSeries


@dataclass(frozen=True)
class AlignedPowers:
    """References of every method that has a calibration."""

    #: calibration of the robust method where it has one, else of the paper method
    calibration: Calibration
    #: references of that method
    references: tuple[CarrierReference, ...]
    references_by_method: dict[str, tuple[CarrierReference, ...]]
    calibration_by_method: dict[str, int]
    consistency: Consistency
    #: carriers whose level changed by more than the limit since the calibration
    changed: tuple[str, ...]

    def to_record(
        self, stated: StatedAngles, window: Window | None, source: str, created_by: str, created_at_us: int = 0
    ) -> Alignment:
        """Return the alignment that these references make, number 0, with the angles that they were taken at."""
        return Alignment(
            id=0,
            epoch_us=stated.epoch_us,
            attitude_deg=stated.attitude_deg,
            sigma_deg=stated.sigma_deg,
            calibration_id=self.calibration.id,
            source=source,
            created_at_us=created_at_us,
            created_by=created_by,
            references=self.references,
            window=window,
            references_by_method=self.references_by_method,
            calibration_by_method=self.calibration_by_method,
            changed_carriers=self.changed,
        )


def align_methods(
    series: MeasurementSeries,
    stated: StatedAngles,
    active: Mapping[CalibrationMethod, Calibration],
    ephemeris: Ephemeris,
    config: AlignmentConfig,
) -> AlignedPowers:
    """Return the references that follow from the powers of a window and the stated angles.

    Parameters
    ----------
    series : MeasurementSeries
        Powers of the window; every carrier of the calibrations has a column, which may be empty.
    stated : StatedAngles
        Outside angles.
    active : mapping
        The active calibration of each kind of fit, at least one.
    ephemeris : Ephemeris
        Orbit that holds.
    config : AlignmentConfig
        Limits.
    """
    geometry = active.get(CalibrationMethod.GEOMETRY)
    makers = (
        (Method.ROBUST, geometry, robust_references),
        (Method.PAPER, active.get(CalibrationMethod.PAPER, geometry), reference_powers),
    )
    found = {
        method: (used, make(columns_of(series, used), stated, used, ephemeris, config))
        for method, used, make in makers
        if used is not None
    }
    calibration, powers = next(iter(found.values()))
    return AlignedPowers(
        calibration,
        powers.references,
        {method.value: reported.references for method, (_calibration, reported) in found.items()},
        {method.value: used.id for method, (used, _reported) in found.items()},
        powers.consistency,
        powers.changed,
    )


def columns_of(series: MeasurementSeries, calibration: Calibration) -> MeasurementSeries:
    """Return a series in the order of a calibration's carriers; NaN for one that the series does not have."""
    wanted = tuple(carrier.id for carrier in calibration.result.carriers) if calibration.result else ()
    position = {carrier: k for k, carrier in enumerate(series.carrier_ids)}
    columns = np.array([position.get(carrier, -1) for carrier in wanted], dtype=np.int64)
    blank = np.full((len(series.epochs_us), 1), np.nan)
    return MeasurementSeries(wanted, series.epochs_us, np.hstack([series.power_dbm, blank])[:, columns])
