"""Knowledge of the ground: at the start of operation from the plant's first lines, and later updates."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from service.pipeline.inputs.knowledge import JournalDocuments
from service.records.calibration import Window
from service.records.catalogue import AxisTorques, FedForwardTorque, Spacecraft
from service.records.epoch import parse_epoch
from service.records.inputs import SlowInput, SourceSelection
from service.records.levels.attitude import BoolArray, IntArray
from service.records.levels.measurement import ReferenceSeries
from service.study.closed_loop.plant_process import Line, Opening
from service.study.estimation.flight import world as flight

_SOURCE = "sa-1"
_NAN = float("nan")
#: one sigma of what a model of the Sun's light has wrong about all axes together, and about each one by itself
RELATIVE_ERROR = 0.06
AXIS_RELATIVE_ERROR = 0.01


def ground_of(opening: Opening) -> flight.Ground:
    """Return what the ground knows before operation; corrections are not flown."""
    bodies: dict[str, Line] = {}
    for line in opening.ground:
        bodies.setdefault(line["kind"], line.get("body", {}))
    epochs_us = np.array(opening.epochs_us, dtype=np.int64)
    phases = [line for line in opening.ground if line["kind"] == "phase"]
    windows = {line["name"]: Window(parse_epoch(line["start"]), parse_epoch(line["stop"])) for line in phases}
    return flight.Ground(
        spacecraft=_spacecraft(bodies["spacecraft"], opening.fed_forward),
        carriers=flight.read_carriers(bodies["carriers"]),
        ephemeris=flight.read_ephemeris(bodies["ephemeris"]),
        events=tuple(_telemetry(opening.ground)),
        corrections=(),
        phases=windows,
        carrier_ids=opening.carrier_ids,
        epochs_us=epochs_us,
        power_dbm=opening.power_dbm,
        is_measured=_is_measured(opening),
        source=_one_source(len(epochs_us)),
        source_names=(_SOURCE,),
        references=_references(opening),
    )


def _telemetry(lines: tuple[Line, ...]) -> Iterator[flight.GroundEvent]:
    """Yield the records of telemetry before operation."""
    for line in lines:
        if line["kind"] == "telemetry":
            yield from (flight.GroundEvent(record.epoch_us, record) for record in flight.read_telemetry(line["body"]))


def _spacecraft(body: Line, fed_forward: Line | None) -> Spacecraft:
    """Return the catalogue's spacecraft with the torque that its loop feeds forward: the ground wrote that profile."""
    record = flight.read_spacecraft(body)
    if fed_forward is None:
        return record
    announced = FedForwardTorque(
        epoch_us=parse_epoch(fed_forward["epoch"]),
        period_s=fed_forward["period_s"],
        constant_n_m=AxisTorques(**fed_forward["constant_n_m"]),
        cosine_n_m=AxisTorques(**fed_forward["cosine_n_m"]),
        sine_n_m=AxisTorques(**fed_forward["sine_n_m"]),
        relative_error=RELATIVE_ERROR,
        axis_relative_error=AXIS_RELATIVE_ERROR,
    )
    return replace(record, onboard=replace(record.onboard, fed_forward_torque=announced))


def slow_inputs(lines: tuple[Line, ...], documents: JournalDocuments, number: int) -> Iterator[SlowInput]:
    """Yield what some lines of the ground tell the chain; operations are numbered from ``number`` on."""
    for position, line in enumerate(lines):
        kind, body = line["kind"], line.get("body", {})
        if kind == "carriers":
            yield documents.add_plan(flight.read_carriers(body))
        elif kind == "ephemeris":
            yield documents.add_ephemeris(flight.read_ephemeris(body))
        elif kind == "operations":
            yield flight.read_operation(body, number + position)
        elif kind == "telemetry":
            # numbers of the wheels' speed and of the body's rate are not read by the chain
            yield from flight.read_telemetry(body)
        elif kind == "source":
            yield SourceSelection(body["source"], number + position)


def _is_measured(opening: Opening) -> BoolArray:
    return np.asarray(np.isfinite(opening.power_dbm).any(axis=1))


def _one_source(count: int) -> IntArray:
    return np.zeros(count, dtype=np.int64)


def _references(opening: Opening) -> tuple[ReferenceSeries, ...]:
    """Return the angles of every sensor."""
    announced: dict[str, list[Line]] = {}
    for line in opening.ground:
        if line["kind"] == "references":
            announced.setdefault(line["body"]["source"], []).extend(line["body"]["references"])
    return tuple(
        ReferenceSeries(
            source,
            np.array([parse_epoch(one["epoch"]) for one in entries], dtype=np.int64),
            np.array([[_number(one[f"{axis}_deg"]) for axis in flight.AXES] for one in entries]),
            np.array([[_number(one["sigma_deg"][axis]) for axis in flight.AXES] for one in entries]),
        )
        for source, entries in announced.items()
    )


def _number(value: float | None) -> float:
    return _NAN if value is None else value
