"""Measuring cycle: sweeps of one analyzer, evaluated to powers of the carriers."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import BoolArray, FloatArray
from service.core.radio import carrier_power
from service.core.radio.levels import initial_presence, mw_from_dbm, step_presence
from service.frontend.drivers.dialects import SweepRefusedError
from service.frontend.drivers.scpi_driver import ScpiDriver
from service.frontend.measurement_task import CarrierPart, InputPart, MeasurementTask, SweepPart
from service.frontend.tasks.task_plan import recheck
from service.records.levels.measurement import QualityFlag, Sweep, SweepSettings

#: what leaks from neighbours above this part of the carrier's power is flagged: 0.1 dB
LEAK_LIMIT = 10.0**0.01 - 1.0
#: distance of edges, in resolution bandwidths, below which a neighbour is flagged
CLOSE_RBW = 2.0
#: C/N in the symbol rate below which a level is flagged, dB
LOW_C_N_DB = 3.0
#: distance from the analyzer's own noise below which the floor is flagged, dB
DANL_MARGIN_DB = 6.0
#: offset of the centre, in symbol rates, above which a carrier is flagged
OFFSET_PART = 0.1


@dataclass(frozen=True, slots=True)
class MeasuredRow:
    """One row, in the order of the task's carriers."""

    #: microseconds UTC, middle of the dwell
    epoch_us: int
    #: (N,) dBm, NaN = absent or not measured
    power_dbm: FloatArray
    #: (N,) masks of QualityFlag
    flags: NDArray[np.int64]
    #: (N,) dB, predicted scatter
    sigma_db: FloatArray
    #: (N,) dB-Hz, carrier over noise density
    c_n0_db_hz: FloatArray
    #: (N,) Hz, width that holds 99 % of the carrier's power; NaN for beacons
    occupied_bandwidth_hz: FloatArray
    #: (N,) Hz, centre of gravity minus the task's centre
    centroid_offset_hz: FloatArray


class SweepEvaluation:
    """Carriers of one sweep.

    Parameters
    ----------
    carriers : tuple of CarrierPart
        In the order of the task.
    path : InputPart
        What lies before the analyzer.
    """

    def __init__(self, carriers: tuple[CarrierPart, ...], path: InputPart) -> None:
        self._carriers = carriers
        self._path = path
        self._center_hz: FloatArray = np.array([carrier.fc_hz for carrier in carriers], dtype=np.float64)
        self._offset_db = level_offset_db(path, self._center_hz)
        self._occupied_hz: FloatArray = np.array([carrier.occupied_hz for carrier in carriers], dtype=np.float64)
        self._rolloff = np.array([carrier.rolloff for carrier in carriers])
        self._presence = initial_presence(len(carriers))
        self._settings: SweepSettings | None = None
        self._weights: carrier_power.BandWeights | None = None
        self._share: FloatArray = np.zeros((len(carriers), len(carriers)))
        self._is_close: BoolArray = np.zeros((len(carriers), len(carriers)), dtype=np.bool_)

    def evaluate(self, sweep: Sweep) -> tuple[carrier_power.CarrierPower, NDArray[np.int64]]:
        """Return the powers of one sweep at the test point, absent ones hidden, and their flags."""
        weights = self._weights_of(sweep.settings)
        power = carrier_power.measure_carriers(sweep.power_mw, weights)
        ratio_db = np.where(sweep.is_stale, np.nan, power.presence_ratio_db)
        self._presence, is_visible = step_presence(self._presence, ratio_db, power.presence_threshold_db)
        is_visible = is_visible & ~np.isnan(power.power_dbm)
        flags = self._flags(power, weights.bands, is_visible) | _sweep_flags(sweep)
        at_test_point = power._replace(power_dbm=power.power_dbm + self._offset_db)
        return carrier_power.hide_absent(at_test_point, is_visible), flags

    def centroid_offset_hz(self, power: carrier_power.CarrierPower) -> FloatArray:
        """Return how far the carriers of the sweep evaluated last lie from where the task has them, Hz."""
        return np.asarray(power.centroid_hz - self._center_hz - self._path.freq_offset_hz, dtype=np.float64)

    def _weights_of(self, settings: SweepSettings) -> carrier_power.BandWeights:
        """Return the weights of these settings, made again when the analyzer states others."""
        if self._weights is None or settings != self._settings:
            bands = self._bands(settings)
            grid = carrier_power.TraceGrid(
                settings.start_hz,
                settings.step_hz,
                settings.points,
                settings.enbw_hz,
                settings.sweep_time_s * settings.count,
            )
            self._weights = carrier_power.weigh_bands(grid, bands)
            self._share = carrier_power.leakage(bands, self._rolloff, settings.rbw_hz)
            self._is_close = _are_close(bands, self._occupied_hz, settings.rbw_hz)
            self._settings = settings
        return self._weights

    def _bands(self, settings: SweepSettings) -> carrier_power.CarrierBands:
        """Return the carriers' bands in the analyzer's frequencies."""
        shift_hz = self._path.freq_offset_hz
        return carrier_power.CarrierBands(
            self._center_hz + shift_hz,
            np.array([c.integ_bw_hz for c in self._carriers]),
            np.array([c.symbol_rate or settings.rbw_hz for c in self._carriers]),
            np.array([c.kind == "beacon" for c in self._carriers], dtype=np.bool_),
            tuple(tuple((low + shift_hz, high + shift_hz) for low, high in c.noise) for c in self._carriers),
        )

    def _flags(
        self, power: carrier_power.CarrierPower, bands: carrier_power.CarrierBands, is_visible: BoolArray
    ) -> NDArray[np.int64]:
        """Return the quality flags that follow from the powers themselves."""
        power_mw = mw_from_dbm(np.where(is_visible, power.power_dbm, np.nan))
        leak = carrier_power.leaked_ratio(self._share, power_mw)
        offset = np.abs(power.centroid_hz - bands.center_hz) / bands.symbol_rate_hz
        is_trusted = is_visible & (power.c_n_db >= LOW_C_N_DB)
        floor_dbm_hz = np.inf if self._path.danl_dbm_hz is None else self._path.danl_dbm_hz + DANL_MARGIN_DB
        found = {
            QualityFlag.NO_CARRIER: ~is_visible & ~power.is_nonfinite,
            QualityFlag.NONFINITE_VALUE: power.is_nonfinite,
            QualityFlag.NEIGHBOUR: is_visible & ((leak > LEAK_LIMIT) | self._has_close(power_mw)),
            QualityFlag.NOISE_WINDOW_DIRTY: power.is_noise_dirty,
            QualityFlag.DANL_LIMITED: (power.n0_dbm_hz < floor_dbm_hz) & (self._path.danl_dbm_hz is not None),
            QualityFlag.LOW_C_N: is_visible & ~is_trusted,
            QualityFlag.FREQUENCY_OFFSET: is_trusted & ~bands.is_line & (offset > OFFSET_PART),
        }
        flags: NDArray[np.int64] = np.sum(
            [int(flag) * is_set for flag, is_set in found.items()], axis=0, dtype=np.int64
        )
        return flags

    def _has_close(self, power_mw: FloatArray) -> BoolArray:
        """Return which carriers have a neighbour so near that its shape counts; a far weaker one cannot matter."""
        with np.errstate(invalid="ignore"):
            matters = power_mw[np.newaxis, :] > LEAK_LIMIT * power_mw[:, np.newaxis]
        return np.asarray((self._is_close & matters).any(axis=1), dtype=np.bool_)


class TaskEvaluation:
    """All sweeps of a task.

    Parameters
    ----------
    task : MeasurementTask
        Checked by the planner.
    """

    def __init__(self, task: MeasurementTask) -> None:
        self._ids = tuple(carrier.id for carrier in task.carriers)
        self._positions = {
            sweep.id: np.array([k for k, carrier in enumerate(task.carriers) if carrier.sweep == sweep.id], dtype=int)
            for sweep in task.sweeps
        }
        self._evaluations = {
            sweep.id: SweepEvaluation(task.carriers_of(sweep.id), task.input)
            for sweep in task.sweeps
            if task.carriers_of(sweep.id)
        }

    def row(self, sweeps: Mapping[str, Sweep | None], *, extra: int = 0) -> MeasuredRow:
        """Return the row of one cycle.

        Parameters
        ----------
        sweeps : mapping
            Sweep id -> sweep; None where it failed while others of the cycle did not.
        extra : int
            Mask of QualityFlag set on every carrier.

        Raises
        ------
        ValueError
            No sweep was taken, or the analyzer's span does not hold the carriers.
        """
        taken = [sweep for sweep in sweeps.values() if sweep is not None]
        if not taken:
            raise ValueError("a cycle without a sweep gives no row")
        measured = np.full((5, len(self._ids)), np.nan)
        of_all = int(extra) | (int(QualityFlag.PARTIAL_CYCLE) if len(taken) < len(sweeps) else 0)
        flags = np.full(len(self._ids), of_all | int(QualityFlag.NOT_MEASURED), dtype=np.int64)
        for sweep in taken:
            evaluation = self._evaluations.get(sweep.sweep_id)
            if evaluation is None:
                continue
            power, own_flags = evaluation.evaluate(sweep)
            positions = self._positions[sweep.sweep_id]
            measured[:, positions] = (
                power.power_dbm,
                power.sigma_db,
                power.c_n0_db_hz,
                power.occupied_bandwidth_hz,
                evaluation.centroid_offset_hz(power),
            )
            flags[positions] = of_all | own_flags
        epoch_us = (min(sweep.epoch_us for sweep in taken) + max(sweep.epoch_us for sweep in taken)) // 2
        power_dbm, sigma_db, c_n0_db_hz, width_hz, offset_hz = measured
        return MeasuredRow(epoch_us, power_dbm, flags, sigma_db, c_n0_db_hz, width_hz, offset_hz)


def level_offset_db(path: InputPart, frequency_hz: FloatArray) -> FloatArray:
    """Return the calibration of the test point at these frequencies, dB."""
    table = path.level_offset_db
    if isinstance(table, tuple):
        points = sorted(table)
        return np.interp(frequency_hz, [point[0] for point in points], [point[1] for point in points])
    return np.full(frequency_hz.shape, table)


def _are_close(bands: carrier_power.CarrierBands, occupied_hz: FloatArray, rbw_hz: float) -> BoolArray:
    """Return which carriers have their edges within two resolution bandwidths of one another, shape (N, N)."""
    away_hz = np.abs(bands.center_hz[:, np.newaxis] - bands.center_hz)
    gap_hz = away_hz - (occupied_hz[:, np.newaxis] + occupied_hz) / 2.0
    is_close: BoolArray = (gap_hz < CLOSE_RBW * rbw_hz) & ~np.eye(occupied_hz.size, dtype=np.bool_)
    return is_close


def _sweep_flags(sweep: Sweep) -> int:
    """Return the flags that a sweep sets on all of its carriers."""
    flags = QualityFlag(0)
    for flag, is_set in (
        (QualityFlag.OVERRANGE, sweep.is_overrange),
        (QualityFlag.UNCAL, sweep.is_uncalibrated),
        (QualityFlag.REFERENCE_UNLOCKED, sweep.is_reference_unlocked),
        (QualityFlag.STALE_TRACE, sweep.is_stale),
        (QualityFlag.SETTING_MISMATCH, sweep.is_setting_mismatch),
    ):
        if is_set:
            flags |= flag
    return int(flags)


logger = logging.getLogger("service.frontend.station")

#: what says of a level that it was not looked for, or not in a fresh trace of numbers
_NOT_GOOD = QualityFlag.NOT_MEASURED | QualityFlag.STALE_TRACE | QualityFlag.NONFINITE_VALUE


class MeasuringCycle:
    """Cycles of one task on one session.

    Parameters
    ----------
    task : MeasurementTask
        Checked by the planner.
    evaluation : TaskEvaluation
        Outlives the session: it remembers which carriers were present.
    driver : ScpiDriver
        Of the open session, preset.
    keep_trace : callable
        Takes every sweep as evidence.
    """

    def __init__(
        self,
        task: MeasurementTask,
        evaluation: TaskEvaluation,
        driver: ScpiDriver,
        keep_trace: Callable[[Sweep], None],
    ) -> None:
        #: what the analyzer makes of the sweeps and the planner would not have let pass
        self.findings: dict[str, str] = {}
        self._task = task
        self._evaluation = evaluation
        self._driver = driver
        self._keep_trace = keep_trace
        self._sweeps = tuple(sweep for sweep in task.sweeps if task.carriers_of(sweep.id))
        self._configured = ""

    def configure(self) -> None:
        """Configure the first sweep, so that a task the analyzer cannot take shows before any row."""
        self._prepare(self._sweeps[0])

    def row(self) -> MeasuredRow:
        """Take all sweeps and return their row."""
        sweeps: dict[str, Sweep | None] = {}
        refusal: SweepRefusedError | None = None
        for sweep in self._sweeps:
            try:
                self._prepare(sweep)
                sweeps[sweep.id] = self._driver.measure(sweep)
            except SweepRefusedError as error:
                logger.warning("%s", error)
                self._configured = ""
                sweeps[sweep.id], refusal = None, error
        if refusal is not None and not any(sweeps.values()):
            raise refusal
        self._end(sweeps)
        extra = QualityFlag.SIMULATED if self._driver.features.has_dwell_epoch else QualityFlag(0)
        return self._evaluation.row(sweeps, extra=int(extra))

    def _end(self, sweeps: dict[str, Sweep | None]) -> None:
        """Keep the evidence, report what the analyzer said, give it back where it is shared."""
        for sweep in sweeps.values():
            if sweep is not None:
                self._keep_trace(sweep)
        for message in self._driver.analyzer_messages:
            logger.warning("the analyzer reports error %d %s", message.code, message.text)
        self._driver.analyzer_messages.clear()
        if self._task.task.analyzer.is_shared:
            self._driver.release()

    def _prepare(self, sweep: SweepPart) -> None:
        """Send and read back the settings of a sweep unless they stand; of a shared analyzer nothing is taken to."""
        if self._configured == sweep.id and not self._task.task.analyzer.is_shared:
            return
        actual = self._driver.configure(sweep, self._task.input)
        self._configured = sweep.id
        for finding in recheck(self._task, sweep, actual):
            text = f"{finding.subject}: {finding.detail}"
            if self.findings.get(finding.rule) != text:
                logger.warning("the analyzer changed the settings of the task: %s", finding)
            self.findings[finding.rule] = text


def is_good(row: MeasuredRow) -> bool:
    """Return whether at least one carrier of a row was looked for in a fresh trace of numbers."""
    return bool(((row.flags & int(_NOT_GOOD)) == 0).any())
