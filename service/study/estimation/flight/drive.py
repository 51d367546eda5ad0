"""The product's own pipeline over one world: calibrate, align, then the chain over every row of the operation phase.

Nothing of the truth is at hand in this module.

The journal of one world, written as a control centre would fill it.

Corrections stand where they are announced, plans, ephemerides, operations and telemetry where the ground learns of
them, each before the first row that is not older.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.anchor import HYPOTHESES
from service.pipeline.alignment.alignment import align_methods
from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.calibration.geometry_rows import CalibrationError, CalibrationInput
from service.pipeline.calibration.minute_rows import mean_edges_us, minute_rows
from service.pipeline.calibration.paper_calibration import calibrate_paper
from service.pipeline.chain import Chain
from service.pipeline.config import AlignmentConfig, CalibrationConfig, ChainConfig
from service.pipeline.estimation.robust.row_recorder import RowRecorder
from service.pipeline.estimation.smoothed import MOST_ROWS, SmoothedRow, SpanSmoother, lagged_angles
from service.pipeline.inputs.knowledge import JournalDocuments
from service.pipeline.inputs.sensor_angles import smooth_angles
from service.records import inputs
from service.records.calibration import Alignment, Calibration, CalibrationMethod, CalibrationRequest, CalibrationState
from service.records.catalogue import CarrierPlan, Ephemeris, Method
from service.records.levels.attitude import AttitudeRow, BoolArray, FloatArray, IntArray
from service.records.levels.measurement import Measurement
from service.study.estimation.flight.world import Ground, journal_entry

#: fixed lag, and how far the rows lie apart at which it is asked, h
LAG_H, _PERIOD_H = 2.0, 0.5
_US_PER_H = 3.6e9
_ANGLES = slice(0, 3)


@dataclass(frozen=True)
class PastSeries:
    """Smoothed angles of M rows."""

    #: (M,) microseconds UTC
    epochs_us: IntArray
    #: (M, 3) deg, yaw, roll, pitch
    estimate_deg: FloatArray
    sigma_deg: FloatArray


@dataclass
class Past:
    """Smoothers beside the chain of a study.

    Parameters
    ----------
    recorder : RowRecorder
        Recorder of the chain.
    """

    recorder: RowRecorder = field(default_factory=lambda: RowRecorder(MOST_ROWS))

    def __post_init__(self) -> None:
        """Begin with no row."""
        self._span = SpanSmoother(self.recorder)
        self._whole: list[SmoothedRow] = []
        self._lagged: list[SmoothedRow] = []

    def push_newest(self) -> None:
        """Take in the newest row of the recorder."""
        rows = self.recorder.rows
        if rows and (not self._lagged or self._is_due(rows[-1].epoch_us)):
            found = lagged_angles(rows, int(LAG_H * _US_PER_H))
            self._lagged += [] if found is None else [found]
        self._whole += self._span.pop()

    def series(self) -> dict[str, PastSeries]:
        """Return the smoothed answers by name after the last row."""
        self._whole += self._span.rest()
        return {"smoothed": _past_series(self._whole), "smoothed_2h": _past_series(self._lagged)}

    def _is_due(self, newest_us: int) -> bool:
        newest = self._lagged[-1]
        return newest_us >= newest.epoch_us + newest.lag_us + int(_PERIOD_H * _US_PER_H)


def _past_series(found: list[SmoothedRow]) -> PastSeries:
    sigma = [np.sqrt(np.diag(each.state.covariance)[_ANGLES]) for each in found]
    return PastSeries(
        np.array([each.epoch_us for each in found], dtype=np.int64),
        np.array([each.state.mean[_ANGLES] for each in found]).reshape(-1, 3),
        np.array(sigma).reshape(-1, 3),
    )


class Entry(NamedTuple):
    """A slow input and when the ground hands it over."""

    epoch_us: int
    content: inputs.SlowInput


def slow_entries(ground: Ground, documents: JournalDocuments) -> list[Entry]:
    """Return the slow inputs in the order in which the ground hands them over."""
    entries = [Entry(reported_us, journal_entry(content, documents)) for reported_us, content in ground.events]
    return sorted(entries, key=lambda entry: entry.epoch_us)


def measurements(
    chain: Chain, ground: Ground, documents: JournalDocuments, entries: list[Entry], rows: IntArray
) -> Iterator[Measurement]:
    """Yield the measurements in order, teaching the chain what comes before each of them."""
    waiting = entries[::-1]
    later = [entry.content.plan_id for entry in entries if isinstance(entry.content, inputs.PlanChange)]
    plan_id, prime = min(later, default=len(documents.plans) + 1) - 1, ground.source_names[0]
    columns = _columns(ground, documents.plans[plan_id])
    for number, row in enumerate(rows.tolist(), start=1):
        epoch_us, source = int(ground.epochs_us[row]), ground.source_names[ground.source[row]]
        while waiting and waiting[-1].epoch_us <= epoch_us:
            content = waiting.pop().content
            chain.update(content)
            if isinstance(content, inputs.PlanChange):
                plan_id, columns = content.plan_id, _columns(ground, documents.plans[content.plan_id])
            elif isinstance(content, inputs.SourceSelection):
                prime = content.source
        power_dbm = ground.power_dbm[row, columns]
        yield Measurement(epoch_us, epoch_us, number, source, plan_id, power_dbm, None, feeds_estimator=source == prime)


def _columns(ground: Ground, plan: CarrierPlan) -> list[int]:
    """Return the columns of the world in the order of a plan."""
    return [ground.carrier_ids.index(name) for name in plan.carrier_ids]


#: what a row says, among its inhibitions or as advice, when the spacecraft moves other than it was told to, or the
#: powers do not fit the model
ALARMS = frozenset({"unannounced_motion", "commands_doubted", "innovations"})

#: rows after which the carriers are asked again for their hypotheses
_ASKED_ROWS = 10


@dataclass(frozen=True)
class MethodSeries:
    """Estimates of one method for the T rows measured in operation; N carriers as in ``Ground``."""

    #: (T, 3) deg, yaw, roll, pitch; NaN = none
    estimate_deg: FloatArray
    sigma_deg: FloatArray
    #: (T, 3) whether control may use the axis
    is_axis_allowed: BoolArray
    #: (T,)
    is_control_allowed: BoolArray
    is_fade: BoolArray
    is_alarm: BoolArray
    #: (T, N) carriers present and left out
    is_excluded: BoolArray
    #: (N,) carriers that the method uses at all
    is_carrier_used: BoolArray
    #: (T, 3) protection levels, deg, NaN = none stated; None = the method states none at all
    protection_deg: FloatArray | None = None


@dataclass(frozen=True)
class Driven:
    """Results of the product in one world."""

    #: (T,) rows of the world that were measured in operation
    rows: IntArray
    alignment_epoch_us: int
    #: (3,) deg
    alignment_deg: FloatArray
    #: keyed by the name of the method
    methods: dict[str, MethodSeries]
    #: (T, N) likeliest of `HYPOTHESES` by the answer of the last ten rows, -1 = none
    hypothesis: IntArray | None = None
    #: per carrier: change with roll, dB/deg
    roll_slopes_db_per_deg: tuple[float, ...] = ()
    #: smoothed answers of the robust method by name
    smoothed: dict[str, PastSeries] = field(default_factory=dict)


class UndrivenError(Exception):
    """The product refused to calibrate or to align in a world; the text is its own."""


def drive(ground: Ground, config: ChainConfig | None = None) -> Driven:
    """Calibrate, align and run the chain over the operation phase.

    Parameters
    ----------
    ground : Ground
        What the ground knows and measures.
    config : ChainConfig, optional
        Every number of every stage; the product's defaults.

    Raises
    ------
    UndrivenError
        The calibration or the alignment was refused.
    """
    past = Past()
    opened = open_chain(ground, config, past.recorder)
    return replace(_operate(opened, ground, past), smoothed=past.series())


class OpenedChain(NamedTuple):
    """Chain that has consumed everything before the rows of operation."""

    chain: Chain
    documents: JournalDocuments
    #: slow inputs of the operation
    entries: list[Entry]

    def measurements(self, ground: Ground) -> Iterator[Measurement]:
        """Yield the rows of operation, teaching the chain what comes before each of them."""
        rows = np.flatnonzero(ground.is_measured & (ground.epochs_us >= ground.phases["operation"].start_us))
        return measurements(self.chain, ground, self.documents, self.entries, rows)


def open_chain(ground: Ground, config: ChainConfig | None = None, recorder: RowRecorder | None = None) -> OpenedChain:
    """Return the chain of a ground, calibrated and aligned.

    Raises
    ------
    UndrivenError
        The calibration or the alignment was refused.
    """
    documents = JournalDocuments()
    opening: list[inputs.SlowInput] = [
        inputs.SpacecraftChange(ground.spacecraft, 1),
        documents.add_plan(ground.carriers),
    ]
    opening.append(documents.add_ephemeris(ground.ephemeris))
    documents.calibrations[1] = calibrate(ground, documents.plans[1], documents.ephemerides[1])
    entries = slow_entries(ground, documents)
    start_us = ground.phases["operation"].start_us
    before = [entry.content for entry in entries if entry.epoch_us < start_us]
    documents.alignments[1] = align(ground, documents)
    chain = Chain(documents, config or ChainConfig(), recorder=recorder)
    for content in (*opening, inputs.CalibrationActivation(1, 1), *before, inputs.AlignmentSet(1)):
        chain.update(content)
    return OpenedChain(chain, documents, entries[len(before) :])


def calibrate(
    ground: Ground, plan: CarrierPlan, ephemeris: Ephemeris, method: CalibrationMethod = CalibrationMethod.GEOMETRY
) -> Calibration:
    """Return the calibration from the quiet days and the turns.

    Raises
    ------
    UndrivenError
        The product refused it.
    """
    data = calibration_input(ground, plan, ephemeris, method)
    try:
        fit = calibrate_paper if method is CalibrationMethod.PAPER else calibrate_geometry
        result = fit(data, CalibrationConfig())
    except CalibrationError as error:
        message = f"calibration refused: {error}"
        raise UndrivenError(message) from error
    return Calibration(1, 1, 1, CalibrationState.ACTIVE, data.request, 0, "study", result)


def calibration_input(
    ground: Ground, plan: CarrierPlan, ephemeris: Ephemeris, method: CalibrationMethod = CalibrationMethod.GEOMETRY
) -> CalibrationInput:
    """Return what a calibration is made of: the quiet days and the turns."""
    quiet, turns = ground.phases["quiet"], ground.phases["turns"]
    request = CalibrationRequest(quiet, turns, method, *ground.sensors)
    edges_us = mean_edges_us(request, ())
    still, turned = (
        minute_rows([ground.series(window, plan.carrier_ids)], plan.carrier_ids, edges_us) for window in (quiet, turns)
    )
    return CalibrationInput(
        request,
        plan,
        ephemeris,
        still.series,
        turned.series,
        ground.references_in(turns),
        ground.references_in(quiet),
        ground.spacecraft,
        row_measurements=still.usual_measurements,
        quiet_first_dbm=still.first_dbm,
        telemetry=tuple(e.content for e in ground.events if isinstance(e.content, inputs.TelemetryRecord)),
        polarization=tuple(e.content for e in ground.events if isinstance(e.content, inputs.PolarizationRecord)),
    )


def align(ground: Ground, documents: JournalDocuments) -> Alignment:
    """Return the alignment from the last hour in which the sensor is on.

    Raises
    ------
    UndrivenError
        No sensor tells all angles.
    """
    window = ground.phases["alignment"]
    calibration, ephemeris = documents.calibrations[1], documents.ephemerides[max(documents.ephemerides)]
    stated, missing = smooth_angles(ground.references_in(window), ground.sensors)
    if stated is None or calibration.result is None:
        message = f"alignment refused: no {' and '.join(missing)} of {', '.join(ground.sensors)}"
        raise UndrivenError(message)
    carrier_ids = tuple(carrier.id for carrier in calibration.result.carriers)
    active = {calibration.request.method: calibration}
    aligned = align_methods(ground.series(window, carrier_ids), stated, active, ephemeris, AlignmentConfig())
    return replace(aligned.to_record(stated, window, ",".join(sorted(set(ground.sensors))), "study"), id=1)


def _operate(opened: OpenedChain, ground: Ground, past: Past) -> Driven:
    """Run the chain over the rows of operation and keep what every method says, and what the smoothers need."""
    chain, documents = opened.chain, opened.documents
    rows = np.flatnonzero(ground.is_measured & (ground.epochs_us >= ground.phases["operation"].start_us))
    reported: list[tuple[AttitudeRow, ...]] = []
    hypothesis: list[list[int]] = []
    for measurement in opened.measurements(ground):
        outcome = chain.step(measurement)
        hypothesis.append(
            _hypotheses(chain, ground.carrier_ids) if len(reported) % _ASKED_ROWS == 0 else hypothesis[-1]
        )
        reported.append(() if outcome is None else outcome.rows)
        past.push_newest()
    names = sorted({row.method.value for some in reported for row in some})
    by_method = {name: [next((row for row in some if row.method == name), None) for some in reported] for name in names}
    alignment, calibrated = documents.alignments[1], documents.calibrations[1].result
    used = {name: _used(documents.calibrations[1], Method(name), ground.carrier_ids) for name in names}
    return Driven(
        rows,
        alignment.epoch_us,
        np.array(alignment.attitude_deg),
        {name: _series(of_method, ground.carrier_ids, used[name]) for name, of_method in by_method.items()},
        np.array(hypothesis, dtype=np.int64).reshape(-1, len(ground.carrier_ids)),
        tuple(carrier.sensitivity_db_per_deg.roll for carrier in calibrated.carriers) if calibrated else (),
    )


def _hypotheses(chain: Chain, carrier_ids: tuple[str, ...]) -> list[int]:
    """Return the likeliest hypothesis of each carrier (N,), -1 where none is stated."""
    newest = chain.carrier_states()
    reported = {} if newest is None else {state.carrier: state.hypothesis for state in newest[1]}
    names = tuple(HYPOTHESES)
    return [names.index(one) if (one := reported.get(name)) else -1 for name in carrier_ids]


def _used(calibration: Calibration, method: Method, carrier_ids: tuple[str, ...]) -> BoolArray:
    """Return the carriers (N,) that a method uses at all."""
    result = calibration.result
    if result is None:
        return np.zeros(len(carrier_ids), dtype=np.bool_)
    is_used = [carrier.selected for carrier in result.carriers]
    if method is Method.ROBUST and result.geometry is not None:
        is_used = list(result.geometry.is_used)
    names = {carrier.id for carrier, used in zip(result.carriers, is_used, strict=True) if used}
    return np.array([name in names for name in carrier_ids], dtype=np.bool_)


def _series(rows: list[AttitudeRow | None], carrier_ids: tuple[str, ...], is_carrier_used: BoolArray) -> MethodSeries:
    """Return the rows of one method as arrays; where it said nothing, nothing is allowed."""
    position = {name: k for k, name in enumerate(carrier_ids)}
    nothing, count = (float("nan"),) * 3, len(rows)
    is_excluded = np.zeros((count, len(carrier_ids)), dtype=np.bool_)
    for k, row in enumerate(rows):
        for carrier, reason in () if row is None else row.excluded:
            is_excluded[k, position[carrier]] = reason != "absent"

    def claims(reported: list[bool]) -> BoolArray:
        return np.array(reported, dtype=np.bool_)

    protection_deg = np.array([nothing if row is None else row.protection_deg for row in rows]).reshape(-1, 3)
    return MethodSeries(
        np.array([nothing if row is None else row.attitude_deg for row in rows]).reshape(-1, 3),
        np.array([nothing if row is None else row.sigma_deg for row in rows]).reshape(-1, 3),
        np.array([(False,) * 3 if row is None else row.control_allowed_axes for row in rows]).reshape(-1, 3),
        claims([row is not None and row.control_allowed for row in rows]),
        claims([row is not None and row.downlink_fade for row in rows]),
        claims([row is not None and not ALARMS.isdisjoint(row.inhibitions + row.advice) for row in rows]),
        is_excluded,
        is_carrier_used,
        protection_deg if np.isfinite(protection_deg).any() else None,
    )
