"""Results of the carriers of a row, method by method, in the order of the row's plan."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from service.pipeline.estimation.method import CarrierLevels, MethodRunner
from service.records.catalogue import CarrierPlan
from service.records.levels.attitude import AttitudeRow, IntArray
from service.records.levels.carrier_results import CARRIER_STATES, CarrierResults
from service.records.levels.measurement import Measurement

_USED, _ABSENT, _EXCLUDED, _UNSELECTED, _UNCALIBRATED = range(len(CARRIER_STATES))


def carrier_results(
    runners: Sequence[MethodRunner], rows: Sequence[AttitudeRow], measurement: Measurement, plan: CarrierPlan
) -> tuple[CarrierResults | None, ...]:
    """Return what each method makes of the carriers at a row that it has just stepped in time; None where it failed."""
    levels = {runner.method: runner.carrier_levels() for runner in runners if runner.is_running}
    return tuple(
        None
        if (known := levels[row.method]) is None or "internal_error" in row.inhibitions
        # a method that failed knows the row before
        else _of_row(known, row, measurement, plan)
        for row in rows
    )


def _of_row(levels: CarrierLevels, row: AttitudeRow, measurement: Measurement, plan: CarrierPlan) -> CarrierResults:
    """Return the results of one method."""
    columns = _columns(plan.carrier_ids, levels.carrier_ids)
    # the last position stands for carriers that the method does not know
    deviation_db, residual_db = (np.append(each, np.nan)[columns] for each in (levels.deviation_db, levels.residual_db))
    excluded = {exclusion.carrier for exclusion in row.excluded}
    is_excluded = np.array([name in excluded for name in levels.carrier_ids])
    states = np.where(is_excluded, _EXCLUDED, np.where(levels.is_used, _USED, _UNSELECTED))
    state = np.append(states, _UNCALIBRATED)[columns]
    state[np.isnan(measurement.power_dbm)] = _ABSENT
    hypothesis = np.append(levels.hypothesis, 0)[columns]
    return CarrierResults(plan.id, deviation_db, residual_db, state, hypothesis)


@lru_cache(maxsize=32)
def _columns(carrier_ids: tuple[str, ...], calibrated: tuple[str, ...]) -> IntArray:
    """Return the positions of a plan's carriers among the calibrated ones, -1 for others."""
    position_of = {name: k for k, name in enumerate(calibrated)}
    return np.array([position_of.get(name, -1) for name in carrier_ids], dtype=np.int64)
