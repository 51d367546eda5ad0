"""One world of the simulator as its file tells it, in two halves that never meet before the judge.

``Ground`` is what a control centre knows and measures; the chain is driven with it alone. ``Truth`` is for the judge.
The file is written by ``python -m analyzer_sim export``, a process of its own; its keys are explained there.

Lines of the simulator's ground as records of the service.

What ``docs/evidence/scenarios.md`` calls the ground's knowledge comes as JSON objects shaped like the bodies of the
REST interface. A study stands beside that interface and feeds the pipeline directly, so it reads them itself; the lines
come from a program of this repository and are taken at their word.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeVar

import numpy as np
from pydantic import TypeAdapter

from service.formats.ephemeris import ephemeris_from_nodes
from service.pipeline.inputs.knowledge import JournalDocuments
from service.records import catalogue, inputs
from service.records.calibration import Window
from service.records.epoch import parse_epoch
from service.records.levels.attitude import Axes, BoolArray, FloatArray, IntArray
from service.records.levels.measurement import MeasurementSeries, ReferenceSeries
from service.study.estimation.flight.motion_statistics import NOTHING_MEASURED, TrueMotion, read_motion_statistics

#: one JSON object
Body = dict[str, Any]


T = TypeVar("T")
_EPOCHS = frozenset({"epoch", "start", "stop", "epochs", "ascending_nodes"})


_adapter = cache(TypeAdapter)


def read_record(kind: type[T], body: Body, **others: Any) -> T:
    """Return the record of an object; ``others`` are fields that it does not state."""
    record: T = _adapter(kind).validate_python(_with_epochs_us(body) | others)  # type: ignore[arg-type] # a class is hashable
    return record


def _with_epochs_us(body: Body) -> Body:
    """Return an object with its epochs in microseconds, under the names that they have in records."""
    members: Body = {}
    for name, value in body.items():
        if name not in _EPOCHS:
            members[name] = _with_epochs_us(value) if isinstance(value, dict) else value
        else:
            members[f"{name}_us"] = list(map(parse_epoch, value)) if isinstance(value, list) else parse_epoch(value)
    return members


def read_carriers(body: Body) -> tuple[catalogue.Carrier, ...]:
    """Return the carriers of a ``carriers`` line in their order."""
    return tuple(read_record(catalogue.Carrier, carrier) for carrier in body["carriers"])


def read_ephemeris(body: Body) -> catalogue.Ephemeris:
    """Return the ephemeris of an ``ephemeris`` line."""
    nodes_us = [parse_epoch(epoch) for epoch in body["ascending_nodes"]]
    return ephemeris_from_nodes(nodes_us, body["nodal_period_s"], read_record(catalogue.Track, body["track"]))


#: of which the ground learns after the start
GroundContent = (
    tuple[catalogue.Carrier, ...]
    | catalogue.Ephemeris
    | inputs.Operation
    | inputs.TelemetryRecord
    | inputs.WeatherReport
    | inputs.PolarizationRecord
    | inputs.SourceSelection
    | inputs.Correction
)


def read_contents(line: Body, number: int) -> Iterator[GroundContent]:
    """Yield what a line tells the chain, numbered by the study; tasks are for the front end."""
    body, kind = line.get("body", {}), line["kind"]
    if kind == "carriers":
        yield read_carriers(body)
    elif kind == "ephemeris":
        yield read_ephemeris(body)
    elif kind == "operations":
        yield read_record(inputs.Operation, body, id=number)
    elif kind == "telemetry":
        yield from (read_record(inputs.TelemetryRecord, record) for record in body["records"])
    elif kind == "polarization":
        source = body["source"]
        yield from (read_record(inputs.PolarizationRecord, record, source=source) for record in body["records"])
    elif kind == "source":
        yield inputs.SourceSelection(body["source"], number)


def journal_entry(content: GroundContent, documents: JournalDocuments) -> inputs.SlowInput:
    """Return the entry of the journal for what the ground has learned; a plan or an ephemeris is a new document."""
    if isinstance(content, tuple):
        return documents.add_plan(content)
    return documents.add_ephemeris(content) if isinstance(content, catalogue.Ephemeris) else content


AXES = ("yaw", "roll", "pitch")

Arrays = dict[str, Any]


class ExportFailedError(Exception):
    """The simulator wrote no world; the text is its own."""


class GroundEvent(NamedTuple):
    """Something of which the ground learns after the start."""

    reported_us: int
    content: GroundContent


@dataclass(frozen=True)
class Ground:
    """Knowledge and measurements of the ground."""

    spacecraft: catalogue.Spacecraft
    #: plan and ephemeris at the start
    carriers: tuple[catalogue.Carrier, ...]
    ephemeris: catalogue.Ephemeris
    #: corrections among them
    events: tuple[GroundEvent, ...]
    corrections: tuple[inputs.Correction, ...]
    phases: dict[str, Window]
    #: names of the columns of ``power_dbm``: carriers of every plan
    carrier_ids: tuple[str, ...]
    #: (T,) microseconds UTC
    epochs_us: IntArray
    #: (T, N) dBm as the archive keeps them, float32 widened; NaN = absent
    power_dbm: FloatArray
    #: (T,) whether an analyzer measured, and the number of its name
    is_measured: BoolArray
    source: IntArray
    source_names: tuple[str, ...]
    #: of every sensor
    references: tuple[ReferenceSeries, ...]

    @property
    def sensors(self) -> tuple[str, str, str]:
        """Sensor that tells yaw, roll, pitch: the first one that does."""
        yaw, roll, pitch = (
            next(reported.source for reported in self.references if np.isfinite(reported.attitude_deg[:, axis]).any())
            for axis in range(3)
        )
        return yaw, roll, pitch

    def series(self, window: Window, carrier_ids: tuple[str, ...]) -> MeasurementSeries:
        """Return the powers of some carriers in a window."""
        rows = _within(self.epochs_us, window) & self.is_measured
        columns = [self.carrier_ids.index(name) for name in carrier_ids]
        return MeasurementSeries(carrier_ids, self.epochs_us[rows], self.power_dbm[rows][:, columns])

    def references_in(self, window: Window) -> tuple[ReferenceSeries, ...]:
        """Return the sensors' angles of a window."""
        inside = [(reported, _within(reported.epochs_us, window)) for reported in self.references]
        return tuple(
            ReferenceSeries(
                reported.source, reported.epochs_us[rows], reported.attitude_deg[rows], reported.sigma_deg[rows]
            )
            for reported, rows in inside
        )


@dataclass(frozen=True)
class TrueStatistics:
    """True statistics of noise and motion; T rows, N carriers, Q parts of a carrier's noise, C of the chain's."""

    #: (T, N) dBm, levels without noise and rain of stations, chain and receiving site
    noise_free_dbm: FloatArray
    #: (T, N, 3) dB/deg at the attitude of the row
    row_sensitivity_db_per_deg: FloatArray
    #: (N,) dB, white noise of a row and amplitude of the wave of the solar day
    white_db: FloatArray
    daily_db: FloatArray
    #: (N, Q) dB and s, sigma 0 = no further part
    part_sigma_db: FloatArray
    part_tau_s: FloatArray
    #: (C,) likewise of the receiving chain, and its wave
    chain_part_sigma_db: FloatArray
    chain_part_tau_s: FloatArray
    chain_daily_db: float
    #: (3,) deg/h, drift of the inertial model
    drift_sigma_deg_h: FloatArray
    drift_tau_s: float
    is_coupled: bool
    #: relative error of the effect of corrections
    correction_scale_sigma: float
    #: of what is measured beside powers
    motion: TrueMotion = NOTHING_MEASURED


@dataclass(frozen=True)
class Truth:
    """Truth of a world, for the judge alone; T rows, N carriers as in ``Ground``."""

    #: (T, 3) deg, yaw, roll, pitch
    attitude_deg: FloatArray
    #: (T,) dB, rain over the receiving site in the band that feels it in full
    downlink_fade_db: FloatArray
    #: (T, N) dB, change of a carrier's own level: steps and gains less the rain over its station
    level_db: FloatArray
    #: (T, N) sums of bits of ``flag_bits``
    flags: IntArray
    flag_bits: dict[str, int]
    #: (N, 3) dB/deg at nominal attitude, and (N,) dB, white noise of a row
    sensitivity_db_per_deg: FloatArray
    white_db: FloatArray
    #: (N,) names of the stations, and (T, N) dB, loss by rain and wet antennas over them
    stations: tuple[str, ...]
    station_loss_db: FloatArray
    #: sensors in operation, which the ground does not hear
    witnesses: tuple[ReferenceSeries, ...] = ()
    #: what noise and motion were drawn from; None = not stated
    statistics: TrueStatistics | None = None

    def has_flag(self, *names: str) -> BoolArray:
        """Return where (T, N) any of the named faults acts."""
        mask = sum(self.flag_bits[name] for name in names)
        return np.asarray((self.flags & mask) != 0)


class World(NamedTuple):
    """Both halves of one world."""

    scenario: str
    seed: int
    row_period_s: float
    ground: Ground
    truth: Truth


def simulated_world(scenario: str, seed: int, operation_days: float | None = None) -> World:
    """Return a world that the simulator makes, its operation as long as stated or as the scenario has it.

    Raises
    ------
    ExportFailedError
        It refused or failed; a scenario that it does not know is the commonest reason.
    """
    length = () if operation_days is None else ("--operation-days", str(operation_days))
    command = [sys.executable, "-m", "analyzer_sim", "export", "--scenario", scenario, "--seed", str(seed), *length]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with TemporaryDirectory(prefix="soo-world-") as folder:
        path = Path(folder) / "world.npz"
        ran = subprocess.run(
            [*command, "--out", str(path)], env=environment, capture_output=True, text=True, check=False
        )
        if ran.returncode == 0:
            return read_world(path)
    lines = ran.stderr.strip().splitlines() or [f"exit code {ran.returncode}"]
    raise ExportFailedError(f"the simulator wrote no world of {scenario}, seed {seed}: {lines[-1]}")


def read_world(path: Path) -> World:
    """Return the world of a file."""
    with np.load(path) as file:
        return world_of({name: file[name] for name in file.files})


def world_of(arrays: Arrays) -> World:
    """Return the world of a file's arrays."""
    epochs_us = arrays["epoch_us"]
    return World(
        str(arrays["scenario"]),
        int(arrays["seed"]),
        float(np.median(np.diff(epochs_us))) / 1e6,
        _ground(arrays),
        _truth(arrays),
    )


def _ground(arrays: Arrays) -> Ground:
    lines = {line["kind"]: line.get("body") for line in json.loads(str(arrays["catalogue_json"]))}
    spans = zip(arrays["phase_name"], arrays["phase_start_us"], arrays["phase_stop_us"], strict=True)
    corrections = _corrections(arrays)
    return Ground(
        spacecraft=read_record(catalogue.Spacecraft, lines["spacecraft"]),
        carriers=read_carriers(lines["carriers"]),
        ephemeris=read_ephemeris(lines["ephemeris"]),
        events=(*corrections, *_ground_events(arrays)),
        corrections=tuple(events.content for events in corrections if isinstance(events.content, inputs.Correction)),
        phases={str(name): Window(int(start), int(stop)) for name, start, stop in spans},
        carrier_ids=tuple(str(name) for name in arrays["carrier_id"]),
        epochs_us=arrays["epoch_us"],
        power_dbm=arrays["power_dbm"].astype(np.float32).astype(np.float64),
        is_measured=_is_measured(arrays),
        source=arrays["source"].astype(np.int64),
        source_names=tuple(str(name) for name in arrays["source_name"]),
        references=_references(arrays, "reference"),
    )


def _is_measured(arrays: Arrays) -> BoolArray:
    """Return in which rows an analyzer measured at all, even if no carrier was on the air."""
    gap = next(value for name, value in zip(arrays["flag_name"], arrays["flag_value"], strict=True) if name == "gap")
    return np.asarray(((arrays["flags"] & gap) == 0).any(axis=1))


def _references(arrays: Arrays, kind: str) -> tuple[ReferenceSeries, ...]:
    """Return the angles of every sensor."""
    angles, sigmas = _by_axis(arrays, f"{kind}_"), _by_axis(arrays, f"{kind}_sigma_")
    epochs_us, source = arrays[f"{kind}_epoch_us"], arrays[f"{kind}_source"]
    chosen = {str(name): source == name for name in dict.fromkeys(source.tolist())}
    return tuple(ReferenceSeries(name, epochs_us[k], angles[k], sigmas[k]) for name, k in chosen.items())


def _ground_events(arrays: Arrays) -> Iterator[GroundEvent]:
    """Yield what the ground learns later; late corrections stand among the others."""
    lines = json.loads(str(arrays["news_json"]))
    for number, (reported_us, line) in enumerate(zip(arrays["news_us"].tolist(), lines, strict=True), start=1):
        yield from (GroundEvent(reported_us, content) for content in read_contents(line, number))


def _corrections(arrays: Arrays) -> tuple[GroundEvent, ...]:
    """Return the announced corrections with the epochs at which they are announced."""
    spans = zip(arrays["correction_start_us"].tolist(), arrays["correction_stop_us"].tolist(), strict=True)
    changes = _by_axis(arrays, "correction_").tolist()
    records = [inputs.Correction(*span, Axes(*change)) for span, change in zip(spans, changes, strict=True)]
    reported_us = arrays["correction_told_us"].tolist()
    return tuple(GroundEvent(reported, record) for reported, record in zip(reported_us, records, strict=True))


def _truth(arrays: Arrays) -> Truth:
    """Return the judge's half."""
    names = zip(arrays["flag_name"], arrays["flag_value"], strict=True)
    return Truth(
        attitude_deg=_by_axis(arrays, ""),
        downlink_fade_db=arrays["downlink_fade_db"],
        level_db=arrays["level_db"] - arrays["uplink_fade_db"],
        flags=arrays["flags"].astype(np.int64),
        flag_bits={str(name): int(value) for name, value in names},
        sensitivity_db_per_deg=arrays["sensitivity_db_per_deg"],
        white_db=arrays["white_db"],
        stations=tuple(str(name) for name in arrays["station_name"]),
        station_loss_db=arrays["uplink_fade_db"],
        witnesses=_references(arrays, "witness"),
        statistics=TrueStatistics(
            **{field.name: _value(arrays[field.name]) for field in fields(TrueStatistics) if field.name != "motion"},
            motion=read_motion_statistics(str(arrays["motion_json"]), arrays["polarimeter_turn_deg"]),
        ),
    )


def _value(array: FloatArray) -> Any:
    """Return an array, widened, or the number of an array without a dimension."""
    return array.astype(np.float64) if array.ndim else array.item()


def _by_axis(arrays: Arrays, prefix: str) -> FloatArray:
    """Return the columns (T, 3) of three arrays named by axis."""
    return np.column_stack([arrays[f"{prefix}{axis}_deg"] for axis in AXES]).reshape(-1, 3)


def _within(epochs_us: IntArray, window: Window) -> BoolArray:
    return np.asarray((epochs_us >= window.start_us) & (epochs_us < window.stop_us))
