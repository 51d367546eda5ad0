"""Ground: everything the ground knows about a world, as JSON objects shaped like the bodies of the service's interface.

Each object is a line `{"kind": ..., "body": {...}}`; `phase` and `truth` lines have no body. A `truth` line is for the
judge alone and must never be forwarded. Nothing here is known from the powers.
"""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from analyzer_sim.ballistics import Ephemeris
from analyzer_sim.carriers import BANDS, ROLLOFF, SPAN_START_HZ, Carrier
from analyzer_sim.effects import FaultFlag, Operation
from analyzer_sim.epochs import US_PER_S, rfc3339
from analyzer_sim.orbit import predicted_track
from analyzer_sim.payload import sensitivity_db_per_deg
from analyzer_sim.plan_versions import PlanVersion
from analyzer_sim.spacecraft import Correction
from analyzer_sim.star_tracker import SIGMA_DEG
from analyzer_sim.story import Phase
from analyzer_sim.streams import FloatArray
from analyzer_sim.structure import crlb_deg
from analyzer_sim.turns import SLEW_MIN, TIMETABLE
from analyzer_sim.user_noise import SWEEP_RBW_HZ, SWEEP_TIME_S
from analyzer_sim.world import LONGITUDE_DEG, World

Line = dict[str, Any]

SPACECRAFT_ID = "yamal-202"
TASK_ID = "yamal-202-ku"
SWEEP_ID = "ku"
SWEEP_POINTS = 2401
#: rows that one hold of the ground port spans
ROWS_PER_CHUNK = 60


def ground_lines(world: World, rows_per_chunk: int = ROWS_PER_CHUNK) -> Iterator[Line]:
    """Yield all lines of a world in the order in which the ground port sends them, holds left out."""
    yield from catalogue_lines(world)
    for first, last, _phase in chunks_of(world, rows_per_chunk):
        yield from chunk_lines(world, first, last)


def chunks_of(world: World, rows_per_chunk: int = ROWS_PER_CHUNK) -> list[tuple[int, int, str]]:
    """Return (first row, last row, phase) of each chunk; a chunk never reaches into the next phase."""
    epochs_us = world.rows.epochs_us
    chunks = []
    for phase in world.scenario.phases:
        begin, end = (int(row) for row in np.searchsorted(epochs_us, [phase.start_us, phase.stop_us]))
        chunks += [(row, min(row + rows_per_chunk, end) - 1, phase.name) for row in range(begin, end, rows_per_chunk)]
    return chunks


def catalogue_lines(world: World) -> Iterator[Line]:
    """Yield what is known before the first row: spacecraft, carriers, task, ephemeris, and for the judge the bound."""
    yield {"kind": "spacecraft", "body": _spacecraft(world)}
    yield from _plan_lines(world, world.plan_versions[0].carriers)
    yield {"kind": "ephemeris", "body": _ephemeris(world, world.ephemerides[0])}
    yield {"kind": "bound", "crlb_deg": _bound(world)}


def news(world: World, start_us: int = -(2**63), stop_us: int = 2**63 - 1) -> Iterator[tuple[int, Line]]:
    """Yield the plans, ephemerides and operations of which the ground learns in [start, stop), with the epochs."""

    def is_new(item: PlanVersion | Ephemeris | Operation) -> bool:
        return start_us <= item.told_us < stop_us

    for version in filter(is_new, world.plan_versions[1:]):
        yield from ((version.told_us, line) for line in _plan_lines(world, version.carriers))
    for ephemeris in filter(is_new, world.ephemerides[1:]):
        yield ephemeris.told_us, {"kind": "ephemeris", "body": _ephemeris(world, ephemeris)}
    for operation in filter(is_new, world.operations):
        yield operation.told_us, {"kind": "operations", "body": _operation(operation)}


def _plan_lines(world: World, carriers: tuple[Carrier, ...]) -> Iterator[Line]:
    yield {"kind": "carriers", "body": {"carriers": [_carrier(world, carrier) for carrier in carriers]}}
    yield {"kind": "task", "body": task(world, carriers)}


def _bound(world: World) -> dict[str, float]:
    """Return the one-row bound of the true beams with a common unknown for the first plan's carriers, deg."""
    columns = [world.plan.column(carrier.id) for carrier in world.plan_versions[0].carriers]
    bound_deg = crlb_deg(sensitivity_db_per_deg(world.plan, world.orbit)[columns])
    return {axis: round(float(value), 6) for axis, value in zip(("yaw", "roll", "pitch"), bound_deg, strict=True)}


def chunk_lines(world: World, first: int, last: int) -> Iterator[Line]:
    """Yield what belongs to the rows first..last, both inclusive."""
    epochs_us = world.rows.epochs_us
    start_us, stop_us = int(epochs_us[first]), int(epochs_us[last]) + world.scenario.row_period_us
    yield from _chunk_news(world, first, stop_us)
    for phase in world.scenario.phases:
        if start_us <= phase.start_us < stop_us:
            yield _phase(phase)
            if phase.name == "turns":
                yield from ({"kind": "operations", "body": operation} for operation in turn_operations(phase))
    tracked = min(last + 1, len(world.references.epochs_us))
    if first < tracked:
        yield {"kind": "references", "body": _references(world, first, tracked)}
    corrections = [_correction(c) for c in world.corrections if start_us <= c.start_us < stop_us]
    if corrections:
        yield {"kind": "corrections", "body": {"corrections": corrections}}
    yield {"kind": "truth", "rows": truth_rows(world, first, last)}


def _chunk_news(world: World, first: int, stop_us: int) -> Iterator[Line]:
    """Yield what becomes known before `stop_us` and was not known when the row before the chunk was swept."""
    known_us = int(world.rows.epochs_us[first - 1]) + world.scenario.row_period_us if first else world.scenario.start_us
    yield from (line for _told_us, line in news(world, known_us, stop_us))


def task(world: World, carriers: tuple[Carrier, ...]) -> Line:
    """Return the measurement task of the front end for some carriers of a world."""
    plan = world.plan
    sweep = {
        "id": SWEEP_ID,
        "start_hz": plan.span_hz[0],
        "stop_hz": plan.span_hz[1],
        "rbw_hz": SWEEP_RBW_HZ,
        "vbw_hz": 10.0 * SWEEP_RBW_HZ,
        "points": SWEEP_POINTS,
        "time_s": SWEEP_TIME_S,
        "detector": "RMS",
        "count": 1,
    }
    windows = [list(window) for window in plan.noise_windows_hz]
    measured = [
        {
            "id": carrier.id,
            "sweep": SWEEP_ID,
            "fc_hz": carrier.center_hz,
            "symbol_rate": carrier.symbol_rate_hz,
            "rolloff": ROLLOFF,
            "integ_bw_hz": carrier.bandwidth_hz,
            "kind": "modulated",
            "noise": windows,
            "limits": {"nominal_dbm": carrier.level_dbm, "warn_db": 2.0, "alarm_db": 4.0, "c_n0_min": 68.0},
        }
        for carrier in carriers
    ]
    levels = {
        "level_offset_db": 0.0,
        "freq_offset_hz": 0.0,
        "attenuation_db": 0.0,
        "ref_level_dbm": -20.0,
        "preamp": False,
    }
    period_s = world.scenario.row_period_s
    return {"id": TASK_ID, "period_s": period_s, "input": levels, "sweeps": [sweep], "carriers": measured}


def turn_operations(phase: Phase) -> list[Line]:
    """Return the timetable of the calibration turns: one operation a turn, its attitude as JSON in the comment."""
    operations = []
    for turn in TIMETABLE:
        if any(turn.attitude_deg):
            start_us = phase.start_us + (turn.start_min + SLEW_MIN) * 60 * US_PER_S
            operations.append(
                {
                    "kind": "calibration_turn",
                    "start": rfc3339(start_us),
                    "stop": rfc3339(phase.start_us + turn.stop_min * 60 * US_PER_S),
                    "carriers": None,
                    "transponders": None,
                    "inhibit_control": True,
                    "comment": json.dumps(_angles(turn.attitude_deg)),
                }
            )
    return operations


def truth_rows(world: World, first: int, last: int) -> list[Line]:
    """Return the truth of the rows first..last; for the judge alone."""
    return [_truth_row(world, row) for row in range(first, last + 1)]


def _truth_row(world: World, row: int) -> Line:
    rows = world.rows
    line = {
        "epoch": rfc3339(int(rows.epochs_us[row])),
        **_angles(rows.attitude_deg[row].tolist()),
        "downlink_fade_db": round(float(rows.downlink_fade_db[row]), 6),
        "chain_db": round(float(rows.chain_db[row]), 6),
    }
    flags = zip(world.carrier_ids, rows.flags[row].tolist(), strict=True)
    faults = {name: [flag.name.lower() for flag in FaultFlag(bits) if flag.name] for name, bits in flags if bits}
    return {**line, "faults": faults} if faults else line


def _spacecraft(world: World) -> Line:
    site = world.plan.receiving_site
    return {
        "id": SPACECRAFT_ID,
        "name": "Yamal-202 (simulated)",
        "cospar_id": "2003-053B",
        "longitude_deg": LONGITUDE_DEG,
        "simulated": True,
        "receiving_site": {
            "name": site.name,
            "latitude_deg": site.latitude_deg,
            "longitude_deg": site.longitude_deg,
            "height_m": site.height_m,
        },
        "inertia_kg_m2": [[2600.0, 0.0, 0.0], [0.0, 1400.0, 0.0], [0.0, 0.0, 2600.0]],
        "torque_limit_n_m": 0.05,
        "onboard": {
            "fast_loop": True,
            "forecast_mode": True,
            "roll_yaw_coupling": world.scenario.keeping.is_coupled_told,
        },
        "control": {"method": "paper", "mode": "ground", "release": "automatic"},
    }


def _carrier(world: World, carrier: Carrier) -> Line:
    offset_hz = carrier.center_hz - SPAN_START_HZ
    station, band, figures = carrier.station, BANDS[carrier.band], world.scenario.repeater
    controlled = "auto" if figures.is_power_control_told else "unknown"
    return {
        "id": carrier.id,
        "name": f"{station.name} {carrier.symbol_rate_hz / 1e3:.0f}k",
        "station": {
            "name": station.name,
            "latitude_deg": station.latitude_deg,
            "longitude_deg": station.longitude_deg,
        },
        "band": band.name,
        "transponder": carrier.transponder,
        "polarization": carrier.polarization,
        "uplink_hz": band.uplink_base_hz + offset_hz,
        "downlink_hz": band.downlink_base_hz + offset_hz,
        "intermediate_hz": carrier.center_hz,
        "bandwidth_hz": carrier.bandwidth_hz,
        "kind": "traffic",
        "uplink_power_control": controlled if carrier.id in figures.power_controlled else "none",
        "transponder_mode": "alc" if carrier.transponder in figures.alc_transponders else "fixed_gain",
        "enabled": True,
    }


def _ephemeris(world: World, ephemeris: Ephemeris) -> Line:
    """Return nodes, nodal period and predicted track with a day of margin on both sides."""
    track = predicted_track(
        ephemeris.orbit, world.seed, ephemeris.start_us, ephemeris.stop_us, name=ephemeris.stream_name
    )
    return {
        "ascending_nodes": [rfc3339(node_us) for node_us in ephemeris.nodes_us],
        "nodal_period_s": round(ephemeris.nodal_period_s, 3),
        "track": {
            "epochs": [rfc3339(epoch_us) for epoch_us in track.epochs_us.tolist()],
            "latitude_deg": track.latitude_deg.tolist(),
            "longitude_deg": track.longitude_deg.tolist(),
        },
    }


def _operation(operation: Operation) -> Line:
    """Return the body of a declared operation."""
    body: Line = {
        "kind": operation.kind,
        "start": rfc3339(operation.start_us),
        "stop": rfc3339(operation.stop_us),
        "carriers": operation.carriers and list(operation.carriers),
        "transponders": operation.transponders and list(operation.transponders),
        "inhibit_control": operation.inhibit_control,
        "comment": operation.comment,
    }
    if operation.attitude_uncertainty_deg is not None:
        angles = zip(("yaw", "roll", "pitch"), operation.attitude_uncertainty_deg, strict=True)
        body["attitude_uncertainty_deg"] = dict(angles)
    return body


def _references(world: World, first: int, stop: int) -> Line:
    told, sigma = world.references, dict(zip(("yaw", "roll", "pitch"), SIGMA_DEG, strict=True))
    rows = zip(told.epochs_us[first:stop].tolist(), told.attitude_deg[first:stop].tolist(), strict=True)
    references = [{"epoch": rfc3339(epoch_us), **_angles(angle), "sigma_deg": sigma} for epoch_us, angle in rows]
    return {"source": "star_tracker", "references": references}


def _phase(phase: Phase) -> Line:
    return {"kind": "phase", "name": phase.name, "start": rfc3339(phase.start_us), "stop": rfc3339(phase.stop_us)}


def _correction(correction: Correction) -> Line:
    return {
        "start": rfc3339(correction.start_us),
        "stop": rfc3339(correction.stop_us),
        **_angles(correction.attitude_deg),
    }


def _angles(attitude_deg: FloatArray | tuple[float, ...] | list[float]) -> dict[str, float]:
    yaw, roll, pitch = (round(float(angle), 7) for angle in attitude_deg)
    return {"yaw_deg": yaw, "roll_deg": roll, "pitch_deg": pitch}
