"""The plant as a process: its lines as records, row by row, and schedules back to it.

``python -m analyzer_sim plant``; its lines are explained in docs/evidence/scenarios.md.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np

from service.records.epoch import format_epoch, parse_epoch
from service.records.levels.attitude import Axes, FloatArray, Pulse

Line = dict[str, Any]
_AXES = ("yaw", "roll", "pitch")
_STOP_TIMEOUT_S = 10.0


class PlantFailedError(Exception):
    """The plant ended by itself or refused a schedule; the text is its own."""


class SpacecraftTruth(NamedTuple):
    """State of the spacecraft at one row; for the judge and for control with perfect sensing."""

    epoch_us: int
    attitude_deg: Axes
    #: what torques have given
    rates_deg_s: Axes
    downlink_fade_db: float
    #: the loop on board has no angles that are young enough
    is_holding: bool = False


class CommandReport(NamedTuple):
    """Telemetry report of the spacecraft on one command."""

    counter: int
    #: executed, executing, replaced, repeated, late or refused
    state: str
    #: N m s, of the executed part
    impulse_n_m_s: Axes
    reported_us: int = 0
    #: end of the executed part; None = nothing was executed
    executed_until_us: int | None = None
    executed_from_us: int | None = None


@dataclass(frozen=True)
class PlantRow:
    """One row of the operation phase."""

    truth: SpacecraftTruth
    #: (N,) dBm as the archive keeps them; None = a gap, and no schedule is taken
    power_dbm: FloatArray | None
    #: lines of the ground since the row before
    ground: tuple[Line, ...]
    reports: tuple[CommandReport, ...]


@dataclass(frozen=True)
class Opening:
    """Data before the start of operation; T rows, N carriers."""

    carrier_ids: tuple[str, ...]
    ground: tuple[Line, ...]
    epochs_us: tuple[int, ...]
    #: (T, N) dBm
    power_dbm: FloatArray
    #: the slowest way to the spacecraft, s
    slowest_s: float
    #: profile that the loop on board feeds forward, as a catalogue states it; None = none is told
    fed_forward: Line | None = None


@dataclass
class _Gathered:
    """Lines between two rows."""

    ground: list[Line] = field(default_factory=list)
    reports: list[CommandReport] = field(default_factory=list)
    truth: Line | None = None


class PlantProcess:
    """A running plant.

    Parameters
    ----------
    scenario : str
        Name of the story.
    seed : int
        Seed of every random quantity.
    uplink : str
        ``ideal`` or ``link``.
    operation_days : float, optional
        Length of the operation phase; None = the story's.
    options : sequence of str
        Further options of its command line.
    """

    def __init__(
        self,
        scenario: str,
        seed: int,
        uplink: str = "link",
        operation_days: float | None = None,
        options: Sequence[str] = (),
    ) -> None:
        command = [sys.executable, "-m", "analyzer_sim", "plant", "--scenario", scenario, "--seed", str(seed)]
        command += ["--uplink", uplink, *options]
        if operation_days is not None:
            command += ["--operation-days", str(operation_days)]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            text=True,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        # reads what is left and closes the pipes
        self._process.communicate(timeout=_STOP_TIMEOUT_S)

    def opening(self) -> Opening:
        """Return everything before operation; to be read first.

        Raises
        ------
        PlantFailedError
            It knows no such story, or failed.
        """
        start = self._line()
        ground: list[Line] = []
        epochs_us: list[int] = []
        powers: list[FloatArray] = []
        while len(epochs_us) < start["open_rows"]:
            line = self._line()
            if line["type"] == "ground":
                ground.append(line["line"])
            elif line["type"] == "row":
                epochs_us.append(parse_epoch(line["epoch"]))
                powers.append(_powers(line))
        return Opening(
            tuple(start["carriers"]),
            tuple(ground),
            tuple(epochs_us),
            np.array(powers),
            start["slowest_s"],
            start["fed_forward_torque"],
        )

    def rows(self) -> Iterator[PlantRow]:
        """Yield the rows of operation; after each one with powers a schedule must be sent."""
        here = _Gathered()
        while (line := self._line())["type"] != "end":
            kind = line["type"]
            if kind == "error":
                raise PlantFailedError(f"the plant refused a schedule: {line['detail']}")
            if kind == "ground":
                here.ground.append(line["line"])
            elif kind == "report":
                here.reports.append(read_report(line))
            elif kind == "truth":
                here.truth = line
                if line.get("is_gap"):
                    yield _row(here, None)
                    here = _Gathered()
            elif here.truth is not None:
                yield _row(here, _powers(line))
                here = _Gathered()

    def send(self, schedule: Sequence[Pulse], counter: int | None, attitude: Line | None = None) -> None:
        """Answer a row; None = nothing is commanded; an attitude is for a loop on board."""
        message: Line = {"schedule": [_element(pulse) for pulse in schedule]}
        if counter is not None:
            message["counter"] = counter
        if attitude is not None:
            message["attitude"] = attitude
        if self._process.stdin is None:
            raise PlantFailedError("the plant has no input")
        self._process.stdin.write(json.dumps(message) + "\n")
        self._process.stdin.flush()

    def _line(self) -> Line:
        text = "" if self._process.stdout is None else self._process.stdout.readline()
        if not text:
            announced = "" if self._process.stderr is None else self._process.stderr.read().strip()
            last = announced.splitlines()[-1] if announced else "no reason given"
            raise PlantFailedError(f"the plant ended early: {last}")
        line: Line = json.loads(text)
        return line


def _row(here: _Gathered, power_dbm: FloatArray | None) -> PlantRow:
    line = here.truth or {}
    truth = SpacecraftTruth(
        parse_epoch(line["epoch"]),
        Axes(*(float(line[f"{axis}_deg"]) for axis in _AXES)),
        Axes(**line["rates_deg_s"]),
        float(line["downlink_fade_db"]),
        line.get("is_holding", False),
    )
    return PlantRow(truth, power_dbm, tuple(here.ground), tuple(here.reports))


def read_report(line: Line) -> CommandReport:
    """Return the report of a ``report`` line."""
    impulse = Axes(**line.get("impulse_n_m_s", dict.fromkeys(_AXES, 0.0)))
    until_us = parse_epoch(line["executed_until"]) if "executed_until" in line else None
    from_us = parse_epoch(line["executed_from"]) if "executed_from" in line else None
    return CommandReport(line["counter"], line["state"], impulse, parse_epoch(line["told"]), until_us, from_us)


def _powers(line: Line) -> FloatArray:
    """Return powers as the archive keeps them: float32, NaN = absent."""
    announced = [np.nan if level is None else level for level in line["power_dbm"]]
    return np.array(announced, dtype=np.float32).astype(np.float64)


def _element(pulse: Pulse) -> Line:
    torques = {f"{axis}_n_m": getattr(pulse.torque_n_m, axis) for axis in _AXES}
    return {"start": format_epoch(pulse.start_us), "duration_s": pulse.duration_s, **torques}
