"""Results of the carriers of a row, method by method, in the order of the row's plan."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from service.pipeline.estimation.method import CarrierColumns, CarrierLevels, MethodRunner
from service.records.catalogue import CarrierPlan
from service.records.levels.attitude import AttitudeRow, CarrierState
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
    states = np.where(levels.is_used, _USED, _UNSELECTED)
    for exclusion in row.excluded:
        # the levels need not know it
        if exclusion.carrier in levels.carrier_ids:
            states[levels.carrier_ids.index(exclusion.carrier)] = _EXCLUDED
    deviation_db, residual_db = (columns.of(each, np.nan) for each in (levels.deviation_db, levels.residual_db))
    state = columns.of(states, _UNCALIBRATED)
    state[np.isnan(measurement.power_dbm)] = _ABSENT
    return CarrierResults(plan.id, deviation_db, residual_db, state, columns.of(levels.hypothesis, 0))


@lru_cache(maxsize=256)
def _columns(carrier_ids: tuple[str, ...], calibrated: tuple[str, ...]) -> CarrierColumns:
    """Return the positions of a plan's carriers among the calibrated ones."""
    return CarrierColumns.among(carrier_ids, {name: k for k, name in enumerate(calibrated)})


def carrier_state(measurement: Measurement, k: int, name: str, known: dict[str, CarrierState]) -> CarrierState:
    """Return the state of the k-th carrier of a row."""
    power_dbm = float(measurement.power_dbm[k])
    flags = 0 if measurement.flags is None else int(measurement.flags[k])
    state = known.get(name) or CarrierState(name, *(math.nan,) * 5, 0, "uncalibrated")
    word = "absent" if np.isnan(power_dbm) else state.state
    return replace(state, power_dbm=power_dbm, flags=flags, state=word)
