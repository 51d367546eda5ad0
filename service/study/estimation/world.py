"""One world of the simulator as its file tells it, in two halves that never meet before the judge.

``Ground`` is what a control centre knows and measures; the chain is driven with it alone. ``Truth`` is for the judge.
The file is written by ``python -m analyzer_sim export``, a process of its own; its keys are explained there.
"""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from service.records.attitude import Axes, BoolArray, FloatArray, IntArray
from service.records.calibration import Window
from service.records.catalogue import Carrier, Ephemeris, Spacecraft
from service.records.inputs import Correction, Operation
from service.records.series import MeasurementSeries, ReferenceSeries
from service.study.estimation.catalogue_lines import read_carriers, read_ephemeris, read_operation, read_spacecraft

AXES = ("yaw", "roll", "pitch")
#: sensor whose angles calibrate and align
SENSOR = "star_tracker"

Arrays = dict[str, Any]


class ExportFailedError(Exception):
    """The simulator wrote no world; the text is its own."""


class News(NamedTuple):
    """Something of which the ground learns after the start."""

    told_us: int
    content: tuple[Carrier, ...] | Ephemeris | Operation


@dataclass(frozen=True)
class Ground:
    """What the ground knows and measures."""

    spacecraft: Spacecraft
    #: plan and ephemeris at the start
    carriers: tuple[Carrier, ...]
    ephemeris: Ephemeris
    #: in order of time
    news: tuple[News, ...]
    corrections: tuple[Correction, ...]
    phases: dict[str, Window]
    #: names of the columns of ``power_dbm``: carriers of every plan
    carrier_ids: tuple[str, ...]
    #: (T,) microseconds UTC
    epochs_us: IntArray
    #: (T, N) dBm as the archive keeps them, float32 widened; NaN = absent
    power_dbm: FloatArray
    references: ReferenceSeries

    def series(self, window: Window, carrier_ids: tuple[str, ...]) -> MeasurementSeries:
        """Return the powers of some carriers in a window, rows without any left out."""
        rows = _within(self.epochs_us, window) & np.isfinite(self.power_dbm).any(axis=1)
        columns = [self.carrier_ids.index(name) for name in carrier_ids]
        return MeasurementSeries(carrier_ids, self.epochs_us[rows], self.power_dbm[rows][:, columns])

    def references_in(self, window: Window) -> tuple[ReferenceSeries, ...]:
        """Return the sensor's angles of a window."""
        told = self.references
        rows = _within(told.epochs_us, window)
        return (ReferenceSeries(told.source, told.epochs_us[rows], told.attitude_deg[rows], told.sigma_deg[rows]),)


@dataclass(frozen=True)
class Truth:
    """What only the judge may see; T rows, N carriers as in ``Ground``."""

    #: (T, 3) deg, yaw, roll, pitch
    attitude_deg: FloatArray
    #: (T,) dB, rain over the receiving site in the band that feels it in full
    downlink_fade_db: FloatArray
    #: (T, N) dB, change of a carrier's own level: steps and gains less the rain over its station
    level_db: FloatArray
    #: (T, N) sums of bits of ``flag_bits``
    flags: IntArray
    flag_bits: dict[str, int]

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


def export_world(scenario: str, seed: int, path: Path, operation_days: float | None = None) -> None:
    """Let the simulator write a world.

    Raises
    ------
    ExportFailedError
        It refused or failed; a scenario that it does not know is the commonest reason.
    """
    length = () if operation_days is None else ("--operation-days", str(operation_days))
    command = [sys.executable, "-m", "analyzer_sim", "export", "--scenario", scenario, "--seed", str(seed)]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    ran = subprocess.run(
        [*command, *length, "--out", str(path)], env=environment, capture_output=True, text=True, check=False
    )
    if ran.returncode != 0:
        lines = ran.stderr.strip().splitlines() or [f"exit code {ran.returncode}"]
        message = f"the simulator wrote no world of {scenario}, seed {seed}: {lines[-1]}"
        raise ExportFailedError(message)


def read_world(path: Path) -> World:
    """Return the world of a file."""
    with np.load(path) as file:
        arrays: Arrays = {name: file[name] for name in file.files}
    epochs_us = arrays["epoch_us"]
    return World(
        str(arrays["scenario"]),
        int(arrays["seed"]),
        float(np.median(np.diff(epochs_us))) / 1e6,
        _ground(arrays),
        _truth(arrays),
    )


def _ground(arrays: Arrays) -> Ground:
    """Return what the ground knows."""
    lines = {line["kind"]: line.get("body") for line in json.loads(str(arrays["catalogue_json"]))}
    spans = zip(arrays["phase_name"], arrays["phase_start_us"], arrays["phase_stop_us"], strict=True)
    angles = _by_axis(arrays, "reference_")
    return Ground(
        spacecraft=read_spacecraft(lines["spacecraft"]),
        carriers=read_carriers(lines["carriers"]),
        ephemeris=read_ephemeris(lines["ephemeris"]),
        news=_news(arrays),
        corrections=_corrections(arrays),
        phases={str(name): Window(int(start), int(stop)) for name, start, stop in spans},
        carrier_ids=tuple(str(name) for name in arrays["carrier_id"]),
        epochs_us=arrays["epoch_us"],
        power_dbm=arrays["power_dbm"].astype(np.float32).astype(np.float64),
        references=ReferenceSeries(
            SENSOR, arrays["reference_epoch_us"], angles, np.tile(arrays["reference_sigma_deg"], (len(angles), 1))
        ),
    )


def _news(arrays: Arrays) -> tuple[News, ...]:
    """Return what the ground learns later; measurement tasks are for the front end."""
    lines = json.loads(str(arrays["news_json"]))
    news = []
    for number, (told_us, line) in enumerate(zip(arrays["news_us"], lines, strict=True), start=1):
        body, kind = line["body"], line["kind"]
        if kind == "carriers":
            news.append(News(int(told_us), read_carriers(body)))
        elif kind == "ephemeris":
            news.append(News(int(told_us), read_ephemeris(body)))
        elif kind == "operations":
            news.append(News(int(told_us), read_operation(body, number)))
    return tuple(news)


def _corrections(arrays: Arrays) -> tuple[Correction, ...]:
    """Return the announced corrections in order of their start."""
    spans = zip(arrays["correction_start_us"], arrays["correction_stop_us"], strict=True)
    changes = _by_axis(arrays, "correction_").tolist()
    return tuple(
        Correction(int(start), int(stop), Axes(*change)) for (start, stop), change in zip(spans, changes, strict=True)
    )


def _truth(arrays: Arrays) -> Truth:
    """Return the judge's half."""
    names = zip(arrays["flag_name"], arrays["flag_value"], strict=True)
    return Truth(
        attitude_deg=_by_axis(arrays, ""),
        downlink_fade_db=arrays["downlink_fade_db"],
        level_db=arrays["level_db"] - arrays["uplink_fade_db"],
        flags=arrays["flags"].astype(np.int64),
        flag_bits={str(name).lower(): int(value) for name, value in names},
    )


def _by_axis(arrays: Arrays, prefix: str) -> FloatArray:
    """Return the columns (T, 3) of three arrays named by axis."""
    return np.column_stack([arrays[f"{prefix}{axis}_deg"] for axis in AXES]).reshape(-1, 3)


def _within(epochs_us: IntArray, window: Window) -> BoolArray:
    """Return which epochs lie in a window."""
    return np.asarray((epochs_us >= window.start_us) & (epochs_us < window.stop_us))
