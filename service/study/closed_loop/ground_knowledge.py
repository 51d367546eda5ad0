"""Knowledge of the ground: at the start of operation from the plant's first lines, and later updates."""

from dataclasses import replace

import numpy as np

from service.records.calibration import Window
from service.records.catalogue import FedForwardTorque, Spacecraft
from service.records.epoch import parse_epoch
from service.records.inputs import TelemetryRecord
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
    reported = [line["body"]["records"] for line in opening.ground if line["kind"] == "telemetry"]
    telemetry = [flight.read_record(TelemetryRecord, record) for records in reported for record in records]
    return flight.Ground(
        spacecraft=_spacecraft(bodies["spacecraft"], opening.fed_forward),
        carriers=flight.read_carriers(bodies["carriers"]),
        ephemeris=flight.read_ephemeris(bodies["ephemeris"]),
        events=tuple(flight.GroundEvent(record.epoch_us, record) for record in telemetry),
        corrections=(),
        phases=windows,
        carrier_ids=opening.carrier_ids,
        epochs_us=epochs_us,
        power_dbm=opening.power_dbm,
        is_measured=np.asarray(np.isfinite(opening.power_dbm).any(axis=1)),
        source=np.zeros(len(epochs_us), dtype=np.int64),
        source_names=(_SOURCE,),
        references=_references(opening),
    )


def _spacecraft(body: Line, fed_forward: Line | None) -> Spacecraft:
    """Return the catalogue's spacecraft with the torque that its loop feeds forward: the ground wrote that profile."""
    record = flight.read_record(Spacecraft, body)
    if fed_forward is None:
        return record
    errors = {"relative_error": RELATIVE_ERROR, "axis_relative_error": AXIS_RELATIVE_ERROR}
    announced = flight.read_record(FedForwardTorque, fed_forward, **errors)
    return replace(record, onboard=replace(record.onboard, fed_forward_torque=announced))


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
