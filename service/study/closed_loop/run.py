"""One closed loop: the plant in its process, the chain in this one, row by row."""

import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from service.pipeline.chain import Chain
from service.pipeline.config import ChainConfig
from service.pipeline.control.release.interlock_conditions import ReleaseSettings
from service.pipeline.inputs.knowledge import JournalDocuments
from service.records.calibration import CalibrationMethod
from service.records.catalogue import ControlMode, Method, Release, Spacecraft
from service.records.epoch import format_epoch
from service.records.inputs import AlignmentSet, CalibrationActivation, PlanChange, SpacecraftChange
from service.records.levels.attitude import BoolArray, FloatArray
from service.records.levels.measurement import Measurement
from service.records.operations.release import UplinkProduct
from service.study.closed_loop.centre import Centre
from service.study.closed_loop.controllers import LEAD_MARGIN_S, LEAD_S, ByTruth, Controller, Sensing
from service.study.closed_loop.ground_knowledge import ground_of
from service.study.closed_loop.plant_process import PlantProcess, PlantRow, SpacecraftTruth
from service.study.estimation.flight.drive import UndrivenError, align, calibrate
from service.study.estimation.flight.world import Ground, journal_entry, read_contents

#: what the spacecraft tells of commands
STATES = ("executed", "executing", "replaced", "repeated", "late", "refused")
#: s: of the closed loop and between commands over the link where the catalogue states the torque
LOOP_PERIOD_S = 2400.0
#: on board angles older than this are not acted on, s
AGE_LIMIT_S = 1800.0
COMMAND_PERIOD_S = 600.0


class LoopUnit(NamedTuple):
    """One run of a campaign: scenario, seed, sensing and uplink."""

    scenario: str
    seed: int
    sensing: Sensing
    #: ``ideal`` or ``link``
    uplink: str = "link"
    #: None = as long as the scenario is
    operation_days: float | None = None
    #: size of the residual torque that the catalogue states, N m; None = what the scenario's says
    residual_torque_n_m: float | None = None
    #: ``ground``: torques go up; ``onboard``: angles do
    mode: str = "ground"
    #: begin and length of a time in which nothing is sent up, h of operation
    silence_h: tuple[float, float] = (0.0, 0.0)
    #: that drives control
    method: Method = Method.ROBUST


@dataclass(frozen=True)
class FlownRun:
    """Record of a flight; T rows of operation."""

    #: (T,) since its start
    hours: FloatArray
    #: (T, 3) deg, yaw, roll, pitch
    truth_deg: FloatArray
    #: (T, 3) deg, NaN = the ground made no estimate
    estimate_deg: FloatArray
    #: (T,)
    is_inhibited: BoolArray
    is_faded: BoolArray
    #: N m s, sum of the sizes of all impulses that were flown
    impulse_n_m_s: tuple[float, float, float]
    #: commands sent, and how many the spacecraft told to have executed, to have had before, to have got too late or
    #: refused
    sent: int
    reported: dict[str, int]
    #: rows that state each reason against control
    reasons: dict[str, int]
    #: conditions by which control tripped
    trips: tuple[str, ...] = ()


@dataclass(frozen=True)
class LoopResult:
    """Result of one run."""

    unit: LoopUnit
    seconds: float
    #: why nothing was flown, empty where it was
    refusal: str = ""
    flight: FlownRun | None = None


def fly_unit(unit: LoopUnit) -> LoopResult:
    """Fly a unit.

    Raises
    ------
    PlantFailedError
        The plant knows no such scenario, or failed.
    """
    began_s = time.monotonic()
    options = ("--age-limit", str(AGE_LIMIT_S)) if unit.mode == "onboard" else ()
    with PlantProcess(unit.scenario, unit.seed, unit.uplink, unit.operation_days, options) as plant:
        try:
            return LoopResult(unit, time.monotonic() - began_s, "", fly(plant, unit))
        except UndrivenError as error:
            return LoopResult(unit, time.monotonic() - began_s, str(error))


def fly(plant: PlantProcess, unit: LoopUnit, restate: Callable[[Spacecraft], Spacecraft] | None = None) -> FlownRun:
    """Fly a plant to its end, its catalogue stated otherwise where that is wanted.

    Raises
    ------
    UndrivenError
        The calibration is not good enough to control by.
    """
    opening = plant.opening()
    ground, documents = ground_of(opening), JournalDocuments()
    spacecraft = ground.spacecraft if restate is None else restate(ground.spacecraft)
    if unit.residual_torque_n_m is not None:
        onboard = replace(spacecraft.onboard, residual_torque_n_m=unit.residual_torque_n_m)
        spacecraft = replace(spacecraft, onboard=onboard)
    ground = replace(ground, spacecraft=spacecraft)
    plan = documents.add_plan(ground.carriers)
    controller = controller_of(unit, ground, documents, plan, opening.slowest_s + LEAD_MARGIN_S)
    return _fly(plant, controller, GroundJournal(ground, documents, plan.plan_id), unit)


def controller_of(
    unit: LoopUnit, ground: Ground, documents: JournalDocuments, plan: PlanChange, lead_s: float = LEAD_S
) -> Controller:
    """Return who closes the loop; commands go out a lead time ahead."""
    is_ideal = unit.uplink == "ideal"
    spacecraft = flown_spacecraft(ground.spacecraft, Release.AUTOMATIC if is_ideal else Release.TWO_STEP)
    if unit.sensing is Sensing.OFF:
        return Controller()
    if unit.sensing is Sensing.TRUTH:
        automatic = flown_spacecraft(ground.spacecraft, Release.AUTOMATIC)
        return ByTruth(automatic, 0.0 if is_ideal else lead_s, float(np.median(np.diff(ground.epochs_us))) / 1e6)
    mode = ControlMode.ONBOARD if unit.mode == "onboard" else ControlMode.GROUND
    spacecraft = replace(spacecraft, control=replace(spacecraft.control, method=unit.method, mode=mode))
    opening = (SpacecraftChange(spacecraft, 1), plan, documents.add_ephemeris(ground.ephemeris))
    by = CalibrationMethod.PAPER if unit.method is Method.PAPER else CalibrationMethod.GEOMETRY
    documents.calibrations[1] = calibrate(ground, documents.plans[1], documents.ephemerides[1], by)
    documents.alignments[1] = align(ground, documents)
    config = ChainConfig()
    chain = Chain(documents, config, methods=(unit.method,))
    for content in (*opening, CalibrationActivation(1, 1), AlignmentSet(1)):
        chain.update(content)
    return Centre(chain, ReleaseSettings(uplink_lead_s=lead_s), config.torque)


def flown_spacecraft(spacecraft: Spacecraft, release: Release) -> Spacecraft:
    """Return the catalogue's spacecraft under a way of release.

    Over the link a spacecraft whose torque is stated, or gathers in wheels that are reported, has commands as quick as
    delay, report and envelope allow; one whose torque nobody knows has the defaults of the catalogue.
    """
    control, onboard = replace(spacecraft.control, release=release), spacecraft.onboard
    if release is Release.TWO_STEP and (onboard.residual_torque_n_m is not None or onboard.momentum is not None):
        control = replace(control, period_s=LOOP_PERIOD_S, command_period_s=COMMAND_PERIOD_S)
    return replace(spacecraft, control=control)


@dataclass
class GroundJournal:
    """Journal of the simulated ground: measurements and slow inputs for the reader of powers."""

    ground: Ground
    documents: JournalDocuments
    plan_id: int
    number: int = 0

    def update(self, row: PlantRow, controller: Controller) -> None:
        """Hand the ground's new inputs to the chain and follow a change of the plan."""
        for number, line in enumerate(row.ground, start=1000 * self.number):
            for content in read_contents(line, number):
                entry = journal_entry(content, self.documents)
                if isinstance(entry, PlanChange):
                    self.plan_id = entry.plan_id
                controller.on_ground(entry)

    def measurement(self, row: PlantRow) -> Measurement:
        """Return the powers of a row in the order of the plan."""
        self.number += 1
        columns = [self.ground.carrier_ids.index(name) for name in self.documents.plans[self.plan_id].carrier_ids]
        power_dbm = np.zeros(0) if row.power_dbm is None else row.power_dbm[columns]
        epoch_us, source = row.truth.epoch_us, self.ground.source_names[0]
        return Measurement(epoch_us, epoch_us, self.number, source, self.plan_id, power_dbm, None, feeds_estimator=True)


def _angles(product: UplinkProduct) -> dict[str, Any]:
    """Return angles as `attitude/uplink` gives them."""
    instants = ("attitude_epoch", product.attitude_epoch_us), ("valid_until", product.valid_until_us)
    epochs = {name: format_epoch(at_us) for name, at_us in instants}
    angles = {} if product.attitude_deg is None else product.attitude_deg._asdict()
    fit = {axis: None if math.isnan(angle) else angle for axis, angle in angles.items()}
    return {"counter": product.counter, **epochs, "attitude_deg": fit}


def _fly(plant: PlantProcess, controller: Controller, journal: GroundJournal, unit: LoopUnit) -> FlownRun:
    truth: list[SpacecraftTruth] = []
    estimates, inhibited, faded, reasons = [], [], [], Counter[str]()
    impulse, reported, sent = np.zeros(3), dict.fromkeys(STATES, 0), 0
    nothing, is_onboard = (np.nan,) * 3, unit.mode == "onboard"
    for row in plant.rows():
        journal.update(row, controller)
        controller.on_input(row.reports)
        for report in row.reports:
            reported[report.state] += 1
            if report.state == "executed":
                impulse += np.abs(report.impulse_n_m_s)
        angles, is_inhibited = None, True
        if row.power_dbm is not None:
            decision = controller.decide(journal.measurement(row), row.truth)
            angles, is_inhibited = decision.attitude_deg, decision.is_inhibited
            reasons.update(decision.reasons)
            first_us = truth[0].epoch_us if truth else row.truth.epoch_us
            silent_h = (row.truth.epoch_us - first_us) / 3.6e9 - unit.silence_h[0]
            is_sent = not 0.0 <= silent_h < unit.silence_h[1]
            product = decision.product if is_sent else None
            schedule = decision.schedule if product is None else product.schedule
            sent += bool(schedule or product)
            counter = sent if product is None else product.counter
            announced = _angles(product) if product is not None and is_onboard else None
            plant.send(schedule if is_sent else (), counter if schedule and is_sent else None, announced)
            if is_onboard:
                is_inhibited = row.truth.is_holding
        truth.append(row.truth)
        estimates.append(nothing if angles is None else tuple(angles))
        inhibited.append(is_inhibited)
        faded.append(row.truth.downlink_fade_db > 0.0)
    epochs_us = np.array([state.epoch_us for state in truth])
    return FlownRun(
        hours=(epochs_us - epochs_us[0]) / 3.6e9,
        truth_deg=np.array([state.attitude_deg for state in truth]),
        estimate_deg=np.array(estimates),
        is_inhibited=np.array(inhibited),
        is_faded=np.array(faded),
        impulse_n_m_s=(float(impulse[0]), float(impulse[1]), float(impulse[2])),
        sent=sent,
        reported=reported,
        reasons=dict(reasons.most_common()),
        trips=controller.trips if isinstance(controller, Centre) else (),
    )


#: deg, yaw, roll, pitch: 95 % of the runs within the first, all of them within the second
NARROW_DEG = (0.4, 0.2, 0.2)
WIDE_DEG = (0.5, 0.3, 0.3)
NARROW_SHARE = 0.95
#: roll and pitch alone
LEVEL_DEG = (math.inf, *NARROW_DEG[1:])
#: roll and pitch of a fade in mid-slew: throughout, and reached so long after the fade, deg and h
FADE_LIMIT_DEG, FADE_SETTLED_DEG, FADE_SETTLE_H = 0.4, 0.1, 3.0
#: the scenario that begins off zero and is judged by the fade's limits
FADE_SCENARIO = "slew_fade"
#: deg, yaw, roll, pitch, and h: under a torque that the catalogue does not know all runs stay within the angles, and no
#: inhibition lasts longer
UNKNOWN_TORQUE_DEG = (1.0, 0.3, 0.3)
UNKNOWN_TORQUE_INHIBITED_H = 0.25 + 1e-9
UNKNOWN_TORQUE_SCENARIOS = ("unknown_residual_constant", "unknown_residual_daily")
#: deg: yaw of 95 % of the runs where the wheels are reported and nobody states the torque that gathers in them
MEASURED_YAW_DEG = 0.25
MEASURED_SCENARIO = "wheels_unstated"
PERCENTILES = (50, 95, 100)


class RunMerit(NamedTuple):
    """Figures of one run; triples in the order yaw, roll, pitch."""

    largest_deg: tuple[float, float, float]
    rms_deg: tuple[float, float, float]
    impulse_n_m_s: tuple[float, float, float]
    inhibited_h: float
    #: h, the longest inhibition without a break
    longest_inhibited_h: float
    #: h after the end of the fade until roll and pitch are both small; inf = never, None = no fade
    settled_h: float | None

    def is_within(self, limits_deg: tuple[float, float, float]) -> bool:
        """Return whether every angle stays within its limit."""
        return all(angle < limit for angle, limit in zip(self.largest_deg, limits_deg, strict=True))

    @property
    def is_unknown_torque_survived(self) -> bool:
        """Return whether the limits under a torque that nobody knows are kept, and control is never lost."""
        return self.is_within(UNKNOWN_TORQUE_DEG) and self.longest_inhibited_h <= UNKNOWN_TORQUE_INHIBITED_H

    @property
    def is_fade_survived(self) -> bool:
        """Return whether roll and pitch stay within the fade's limit and come back in time."""
        is_settled = self.settled_h is not None and self.settled_h <= FADE_SETTLE_H
        return max(self.largest_deg[1:]) < FADE_LIMIT_DEG and is_settled


class OwnLimits(NamedTuple):
    """Limits of a scenario in place of those of all others, and the share of the runs that must keep them."""

    is_kept: Callable[[RunMerit], bool]
    needed_share: float = 1.0


OWN_LIMITS = {
    FADE_SCENARIO: OwnLimits(lambda merit: merit.is_fade_survived),
    **dict.fromkeys(UNKNOWN_TORQUE_SCENARIOS, OwnLimits(lambda merit: merit.is_unknown_torque_survived)),
    # thrusters that nobody declares take control away for a while
    "plant_varied": OwnLimits(lambda merit: merit.is_within(UNKNOWN_TORQUE_DEG)),
    MEASURED_SCENARIO: OwnLimits(
        lambda merit: merit.largest_deg[0] <= MEASURED_YAW_DEG and merit.is_within(LEVEL_DEG), NARROW_SHARE
    ),
}


@dataclass(frozen=True)
class GroupMerit:
    """Figures of the runs of one scenario under one sensing; refused runs count as missed."""

    scenario: str
    sensing: Sensing
    runs: int
    refused: int
    narrow_share: float
    wide_share: float
    #: roll and pitch alone within the narrow limits
    level_share: float
    #: of 50, 95 and 100 % of the runs; (3,) yaw, roll, pitch each
    largest_deg: tuple[tuple[float, float, float], ...]
    impulse_n_m_s: tuple[tuple[float, float, float], ...]
    inhibited_h: tuple[float, ...]
    longest_inhibited_h: float
    #: share of the runs that keep the limits of the scenario's own; None = it has none
    survived_share: float | None
    #: longest time to come back after the fade; None = no such story
    settled_h: float | None

    @property
    def is_met(self) -> bool:
        """Return whether what was asked is reached; without control it must not be."""
        if self.survived_share is not None:
            return self.survived_share >= OWN_LIMITS[self.scenario].needed_share
        return self.narrow_share >= NARROW_SHARE and self.wide_share == 1.0


def run_merit(flight: FlownRun) -> RunMerit:
    """Return the figures of one flight."""
    size = np.abs(flight.truth_deg)
    step_h = float(np.median(np.diff(flight.hours)))
    return RunMerit(
        _triple(size.max(axis=0)),
        _triple(np.sqrt(np.mean(size**2, axis=0))),
        flight.impulse_n_m_s,
        float(flight.is_inhibited.sum()) * step_h,
        _longest_run(flight.is_inhibited) * step_h,
        _settled_h(flight),
    )


def group_merit(results: Sequence[LoopResult]) -> GroupMerit:
    """Return the figures of the runs of one scenario under one sensing."""
    unit, runs = results[0].unit, len(results)
    merits = [run_merit(result.flight) for result in results if result.flight is not None]
    is_fade, own = unit.scenario == FADE_SCENARIO, OWN_LIMITS.get(unit.scenario)

    def share(is_kept: Callable[[RunMerit], bool]) -> float:
        return sum(map(is_kept, merits)) / runs

    return GroupMerit(
        scenario=unit.scenario,
        sensing=unit.sensing,
        runs=runs,
        refused=runs - len(merits),
        narrow_share=share(lambda merit: merit.is_within(NARROW_DEG)),
        wide_share=share(lambda merit: merit.is_within(WIDE_DEG)),
        level_share=share(lambda merit: merit.is_within(LEVEL_DEG)),
        largest_deg=_percentiles([merit.largest_deg for merit in merits]),
        impulse_n_m_s=_percentiles([merit.impulse_n_m_s for merit in merits]),
        inhibited_h=tuple(triple[0] for triple in _percentiles([(merit.inhibited_h,) * 3 for merit in merits])),
        longest_inhibited_h=max((merit.longest_inhibited_h for merit in merits), default=float("inf")),
        survived_share=None if own is None else share(own.is_kept),
        settled_h=max((merit.settled_h or 0.0 for merit in merits), default=float("inf")) if is_fade else None,
    )


def _percentiles(values: Sequence[tuple[float, float, float]]) -> tuple[tuple[float, float, float], ...]:
    """Return the percentiles over the runs, one triple each; NaN where none was flown."""
    if not values:
        return ((float("nan"),) * 3,) * len(PERCENTILES)
    # the next run that was flown, nothing in between: a percentile of few runs is a run
    table = np.percentile(np.array(values), PERCENTILES, axis=0, method="higher")
    return tuple(_triple(row) for row in table)


def _longest_run(is_set: BoolArray) -> int:
    """Return the length of the longest run of rows that are set."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_set, [False]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _settled_h(flight: FlownRun) -> float | None:
    """Return the time from the end of the fade until roll and pitch are both small."""
    wet = np.flatnonzero(flight.is_faded)
    if not len(wet):
        return None
    end = int(wet[-1])
    small = np.flatnonzero((np.abs(flight.truth_deg[end:, 1:]) < FADE_SETTLED_DEG).all(axis=1))
    return float(flight.hours[end + int(small[0])] - flight.hours[end]) if len(small) else float("inf")


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
