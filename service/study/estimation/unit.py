"""One scenario with one seed: the world exported, the product driven over it, everything measured.

A unit is what a process of the campaign works on, so what it returns travels between processes and stays small.
"""

import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from service.records.catalogue import Method
from service.records.levels.attitude import BoolArray, IntArray
from service.records.levels.measurement import Float32Array
from service.study.estimation.bounds import Accuracy, measure_accuracy
from service.study.estimation.flight.baselines import baseline_answers
from service.study.estimation.flight.drive import Driven, UndrivenError, drive
from service.study.estimation.flight.oracle.filter import ORACLE, oracle_series
from service.study.estimation.flight.world import World, export_world, read_world
from service.study.estimation.measures import Measures, judged_rows, measure_method
from service.study.estimation.smoothing_gain import SmoothingGain, measure_gain
from service.study.estimation.yardstick import Yardstick, measure_yardstick, measure_yardsticks


class Unit(NamedTuple):
    """One run of a campaign: scenario and seed."""

    scenario: str
    seed: int
    #: None = as long as the scenario is
    operation_days: float | None = None


class Drawn(NamedTuple):
    """Answer of one method as it is drawn; T rows."""

    #: (T, 3) deg, yaw, roll, pitch
    estimate_deg: Float32Array
    sigma_deg: Float32Array
    #: (T,)
    is_control_allowed: BoolArray
    #: (T, 3) deg, NaN = none stated
    protection_deg: Float32Array | None = None


class Rain(NamedTuple):
    """True rain, and the hypotheses of the carriers."""

    #: (T, N) loss by rain and wet antennas, dB
    loss_db: Float32Array
    #: (T, N) likeliest hypothesis by position, -1 = none
    hypothesis: IntArray


class Course(NamedTuple):
    """Operation phase of one world as it is drawn; T rows."""

    #: (T,) since the start of operation
    hours: Float32Array
    #: (T, 3) deg
    truth_deg: Float32Array
    #: (T,) whether the spacecraft is in the shadow or has not warmed yet
    is_night: BoolArray
    methods: dict[str, Drawn]
    rain: Rain | None = None
    #: (T, 3) deg, robust rows smoothed by all later ones, NaN = no row
    smoothed_deg: Float32Array | None = None


@dataclass(frozen=True)
class UnitResult:
    """Result of one run."""

    unit: Unit
    seconds: float
    #: reason why the chain could not run, empty where it could
    refusal: str = ""
    methods: dict[str, Measures] = field(default_factory=dict)
    baselines: dict[str, Accuracy] = field(default_factory=dict)
    course: Course | None = None
    #: by name of the answer
    yardsticks: dict[str, Yardstick] = field(default_factory=dict)
    #: of the smoothed answers, by name
    gains: dict[str, SmoothingGain] = field(default_factory=dict)


def run_unit(unit: Unit) -> UnitResult:
    """Export the world of a unit, drive the product over it and measure what it said.

    Raises
    ------
    ExportFailedError
        The simulator wrote no world.
    """
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="soo-study-") as folder:
        path = Path(folder) / "world.npz"
        export_world(unit.scenario, unit.seed, path, unit.operation_days)
        world = read_world(path)
    driven = _driven(world)
    if isinstance(driven, str):
        return UnitResult(unit, time.monotonic() - began_s, driven)
    oracle = oracle_series(world, driven.rows)
    everyone = {**driven.methods, ORACLE: oracle}
    methods = {name: measure_method(world, driven, series) for name, series in everyone.items()}
    baselines, course = _baselines(world, driven), _course(world, driven)
    yardsticks = {**measure_yardsticks(world, driven, Method.ROBUST), ORACLE: measure_yardstick(world, driven, oracle)}
    robust = driven.methods.get(Method.ROBUST)
    past = {} if robust is None else driven.smoothed
    gains = {name: measure_gain(world, driven, robust, series) for name, series in past.items() if robust is not None}
    return UnitResult(unit, time.monotonic() - began_s, "", methods, baselines, course, yardsticks, gains)


def _driven(world: World) -> Driven | str:
    """Return what the product made of a world, or why it made nothing."""
    try:
        return drive(world.ground)
    except UndrivenError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 - a world that breaks the product must not hide what it does in the others
        return f"the product failed: {type(error).__name__}: {error}"


def _baselines(world: World, driven: Driven) -> dict[str, Accuracy]:
    """Return what the answers without powers amount to."""
    judged = judged_rows(world, driven)
    epochs_us = world.ground.epochs_us[driven.rows]
    answers = baseline_answers(epochs_us, driven.alignment_epoch_us, driven.alignment_deg, world.ground.corrections)
    truth_deg = world.truth.attitude_deg[driven.rows[judged]]
    unknown = np.full(truth_deg.shape, np.nan)
    return {name: measure_accuracy(answer[judged], unknown, truth_deg) for name, answer in answers.items()}


def _course(world: World, driven: Driven) -> Course:
    """Return what is drawn."""
    rows = driven.rows
    hours = (world.ground.epochs_us[rows] - world.ground.phases["operation"].start_us) / 3.6e9
    return Course(
        hours.astype(np.float32),
        world.truth.attitude_deg[rows].astype(np.float32),
        np.asarray(world.truth.has_flag("eclipse")[rows].any(axis=1)),
        {
            name: Drawn(
                series.estimate_deg.astype(np.float32),
                series.sigma_deg.astype(np.float32),
                series.is_control_allowed,
                None if series.protection_deg is None else series.protection_deg.astype(np.float32),
            )
            for name, series in driven.methods.items()
        },
        None
        if driven.hypothesis is None
        else Rain(world.truth.station_loss_db[rows].astype(np.float32), driven.hypothesis),
        _smoothed_deg(world.ground.epochs_us[rows], driven),
    )


def _smoothed_deg(epochs_us: IntArray, driven: Driven) -> Float32Array | None:
    """Return the smoothed angles at each row (T, 3)."""
    series = driven.smoothed.get("smoothed")
    if series is None:
        return None
    angles = np.full((len(epochs_us), 3), np.nan, dtype=np.float32)
    _, own, theirs = np.intersect1d(epochs_us, series.epochs_us, return_indices=True)
    angles[own] = series.estimate_deg[theirs]
    return angles
