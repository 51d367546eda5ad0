"""Flights on disk: a campaign that was stopped goes on where it stood."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from service.records.catalogue import Method
from service.study.closed_loop.controllers import Sensing
from service.study.closed_loop.run import FlownRun, LoopResult, LoopUnit

_ARRAYS = ("hours", "truth_deg", "estimate_deg", "is_inhibited", "is_faded")


def keep(folder: Path, result: LoopResult) -> None:
    """Write a result; what is half written is not there."""
    flight = result.flight
    head = {
        "unit": result.unit._asdict(),
        "seconds": result.seconds,
        "refusal": result.refusal,
        "flight": None
        if flight is None
        else {name: value for name, value in asdict(flight).items() if name not in _ARRAYS},
    }
    arrays = {} if flight is None else {name: getattr(flight, name) for name in _ARRAYS}
    folder.mkdir(parents=True, exist_ok=True)
    path = _path(folder, result.unit)
    half = path.with_suffix(".half")
    with half.open("wb") as file:
        np.savez_compressed(file, head=np.array(json.dumps(head)), **arrays)
    half.replace(path)


def kept(folder: Path, unit: LoopUnit) -> LoopResult | None:
    """Return the result of a unit that was kept; None where there is none, or one of another length or setting."""
    path = _path(folder, unit)
    if not path.exists():
        return None
    with np.load(path) as stored:
        head = json.loads(str(stored["head"]))
        if _unit(head["unit"]) != unit:
            return None
        flight = None
        if head["flight"] is not None:
            rest = {name: tuple(value) if isinstance(value, list) else value for name, value in head["flight"].items()}
            flight = FlownRun(**{name: stored[name] for name in _ARRAYS}, **rest)  # type: ignore[arg-type]
    return LoopResult(unit, head["seconds"], head["refusal"], flight)


def _unit(announced: dict[str, object]) -> LoopUnit:
    """Return the unit of a file."""
    named = {name: tuple(value) if isinstance(value, list) else value for name, value in announced.items()}
    enums = {"sensing": Sensing(str(named["sensing"])), "method": Method(str(named["method"]))}
    return LoopUnit(**{**named, **enums})  # type: ignore[arg-type]


def _path(folder: Path, unit: LoopUnit) -> Path:
    return folder / f"{unit.scenario}-{unit.method.value}-{unit.sensing.value}-{unit.seed}.npz"
