"""Ground: everything the ground knows about a world, as JSON objects shaped like the bodies of the service's interface.

Each object is a line `{"kind": ..., "body": {...}}`; `phase` and `truth` lines have no body. A `truth` line is for the
judge alone and must never be forwarded. Nothing here is known from the powers.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from analyzer_sim.epochs import US_PER_S, rfc3339
from analyzer_sim.streams import FloatArray
from analyzer_sim.world.ballistics import Ephemeris
from analyzer_sim.world.orbit import predicted_track
from analyzer_sim.world.payload.carriers import BANDS, ROLLOFF, SPAN_START_HZ, Carrier
from analyzer_sim.world.payload.effects import FaultFlag, Operation
from analyzer_sim.world.payload.level_terms import SWEEP_RBW_HZ, SWEEP_TIME_S, sensitivity_db_per_deg
from analyzer_sim.world.polarimeter import FIELD_T, FREQUENCY_HZ, SOURCE, PolarizationReport
from analyzer_sim.world.scenario.story import SLEW_MIN, TIMETABLE, Phase
from analyzer_sim.world.spacecraft.body import INERTIA_KG_M2
from analyzer_sim.world.spacecraft.spacecraft import Correction
from analyzer_sim.world.spacecraft.telemetry import TelemetryRecord, stated_profile
from analyzer_sim.world.structure import crlb_deg
from analyzer_sim.world.world import LONGITUDE_DEG, World

Line = dict[str, Any]

SPACECRAFT_ID = "yamal-202"
TASK_ID = "yamal-202-ku"
SWEEP_ID = "ku"
SWEEP_POINTS = 2401
#: largest torque on the body about an axis
TORQUE_LIMIT_N_M = 0.05
AXES = ("yaw", "roll", "pitch")


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
            "symbol_rate": None if carrier.is_beacon else carrier.symbol_rate_hz,
            "rolloff": ROLLOFF,
            "integ_bw_hz": carrier.bandwidth_hz,
            "kind": "beacon" if carrier.is_beacon else "modulated",
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


def spacecraft_body(world: World, *, is_flown: bool = False) -> Line:
    """Return the body of the spacecraft."""
    site, keeping = world.plan.receiving_site, world.scenario.keeping
    # null: an operator who knows of no torque states none
    residual_n_m = 0.0 if world.scenario.is_torque_stated else None
    body: Line = {
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
        "inertia_kg_m2": np.diag(np.multiply(INERTIA_KG_M2, keeping.stated_inertia)).tolist(),
        "torque_limit_n_m": TORQUE_LIMIT_N_M,
        "onboard": {
            "fast_loop": True,
            "forecast_mode": True,
            "roll_yaw_coupling": keeping.is_coupling_announced,
            "residual_torque_n_m": residual_n_m,
            **_momentum(world, is_flown=is_flown),
            **_rate_sensor(world, is_flown=is_flown),
        },
        # torques do not reach a story that is only replayed, so none may count as applied
        "control": {"method": "robust", "mode": "ground", "release": "two_step"},
    }
    figures = world.scenario.polarimeter
    if figures is not None and not is_flown:
        stated = {
            "source": SOURCE,
            "feed_offset_deg": figures.feed_offset_deg,
            "frequency_hz": FREQUENCY_HZ,
            "field_t": FIELD_T,
            "white_deg": figures.white_deg,
            # with what a map leaves of the Faraday rotation
            "daily_deg": 0.04,
            "wander_deg": figures.wander_deg,
        }
        body["polarimeters"] = [stated]
    return body


def _momentum(world: World, *, is_flown: bool) -> Line:
    """Return what the catalogue says of the wheels: their errors and the torque that gathers in them alone."""
    figures = world.scenario.wheels
    if figures is None:
        return {}
    errors = {"sigma_n_m_s": figures.noise_n_m_s, "scale_error": figures.scale_error}
    # three times as wrong as stated where the story says so
    stated = {**errors, "misalignment_deg": 0.05, "pitch_bias_n_m_s": figures.bias_n_m_s, "used": True}
    if is_flown or not figures.is_profile_stated:
        # what acts on a flown body moves it too: it is the profile that is fed forward
        return {"momentum": stated}
    profile = stated_profile(figures, world.seed)
    parts = zip(("constant_n_m", "cosine_n_m", "sine_n_m"), profile, strict=True)
    torque = {
        "epoch": rfc3339(world.scenario.start_us),
        "period_s": 86_400.0,
        **{name: dict(zip(("roll", "pitch", "yaw"), part.tolist(), strict=True)) for name, part in parts},
        "relative_error": figures.profile_error,
        "axis_relative_error": figures.axis_profile_error,
    }
    return {"momentum": {**stated, "torque": torque}}


def _rate_sensor(world: World, *, is_flown: bool) -> Line:
    """Return what the catalogue says of the rate sensor; that of the flown spacecraft is the loop's own."""
    figures = world.scenario.rates
    if figures is None:
        return {}
    if is_flown:
        return {"rate_sensor": {"in_loop": True}}
    errors = ("bias_deg_h", "bias_tau_h", "noise_deg_sqrt_h")
    return {"rate_sensor": {"in_loop": False, **{name: getattr(figures, name) for name in errors}}}


def carrier_body(world: World, carrier: Carrier) -> Line:
    """Return one carrier of a plan; a beacon has neither station nor uplink."""
    offset_hz = carrier.center_hz - SPAN_START_HZ
    station, band, figures = carrier.station, BANDS[carrier.band], world.scenario.repeater
    controlled = "auto" if figures.is_power_control_announced else "unknown"
    return {
        "id": carrier.id,
        "name": "beacon" if carrier.is_beacon else f"{station.name} {carrier.symbol_rate_hz / 1e3:.0f}k",
        "station": None
        if carrier.is_beacon
        else {
            "name": station.name,
            "latitude_deg": station.latitude_deg,
            "longitude_deg": station.longitude_deg,
        },
        "band": band.name,
        "transponder": carrier.transponder,
        "polarization": carrier.polarization,
        "uplink_hz": None if carrier.is_beacon else band.uplink_base_hz + offset_hz,
        "downlink_hz": band.downlink_base_hz + offset_hz,
        "intermediate_hz": carrier.center_hz,
        "bandwidth_hz": carrier.bandwidth_hz,
        "kind": "beacon" if carrier.is_beacon else "traffic",
        "uplink_power_control": controlled if carrier.id in figures.power_controlled else "none",
        "transponder_mode": "alc" if carrier.transponder in figures.alc_transponders else "fixed_gain",
        "enabled": True,
    }


def ephemeris_body(world: World, ephemeris: Ephemeris) -> Line:
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


def operation_body(operation: Operation) -> Line:
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
        angles = zip(AXES, operation.attitude_uncertainty_deg, strict=True)
        body["attitude_uncertainty_deg"] = dict(angles)
    return body


def reference_bodies(world: World, start_us: int, stop_us: int) -> list[Line]:
    """Return the references of [start, stop), one body a sensor; an axis that a sensor does not tell is null."""
    reported = world.references
    first, stop = (int(row) for row in np.searchsorted(reported.epochs_us, [start_us, stop_us]))
    bodies = []
    for source in dict.fromkeys(reported.source[first:stop].tolist()):
        rows = [row for row in range(first, stop) if reported.source[row] == source]
        references = [
            {
                "epoch": rfc3339(int(reported.epochs_us[row])),
                **angles(reported.attitude_deg[row].tolist()),
                "sigma_deg": dict(zip(AXES, map(_present, reported.sigma_deg[row].tolist()), strict=True)),
            }
            for row in rows
        ]
        bodies.append({"source": source, "references": references})
    return bodies


def corrections_body(corrections: Sequence[Correction]) -> Line:
    """Return a batch of corrections."""
    entries = [
        {"start": rfc3339(one.start_us), "stop": rfc3339(one.stop_us), **angles(one.attitude_deg)}
        for one in corrections
    ]
    return {"corrections": entries}


def telemetry_body(record: TelemetryRecord) -> Line:
    """Return a batch of one record."""
    entry: Line = {"epoch": rfc3339(record.reported_us), "onboard_mode": record.onboard_mode}
    if record.wheel_momentum_n_m_s is not None:
        entry["wheel_momentum_n_m_s"] = list(record.wheel_momentum_n_m_s)
    entry["thrusters_active"] = record.thrusters_active
    if record.body_rate_deg_s is not None:
        entry["body_rate_deg_s"] = dict(zip(AXES, record.body_rate_deg_s, strict=True))
    return {"records": [entry]}


def polarization_body(report: PolarizationReport) -> Line:
    """Return a batch of one report of the polarimeter."""
    entry = {
        "epoch": rfc3339(report.reported_us),
        "ratio_db": report.ratio_db,
        "co_power_dbm": report.co_power_dbm,
        "noise_db": report.noise_db,
        "tec_tecu": report.tec_tecu,
    }
    return {"source": SOURCE, "records": [entry]}


def angles(attitude_deg: FloatArray | Iterable[float]) -> dict[str, float | None]:
    """Return yaw, roll, pitch by name; NaN is null."""
    return {f"{axis}_deg": _present(round(float(angle), 7)) for axis, angle in zip(AXES, attitude_deg, strict=True)}


def _present(value: float) -> float | None:
    return None if np.isnan(value) else value


#: rows that one hold of the ground port spans
ROWS_PER_CHUNK = 60
#: lines that are not told where torques are flown: nobody flies corrections, the spacecraft has telemetry of its own,
#: and a polarimeter looks at the story's attitude
_NOT_FLOWN = {"corrections", "telemetry", "polarization"}


def chunks_of(world: World, rows_per_chunk: int = ROWS_PER_CHUNK) -> list[tuple[int, int, str]]:
    """Return (first row, last row, phase) of each chunk.

    A chunk never reaches into the next phase, nor over a new plan or another analyzer; the first row of another
    analyzer is a chunk of its own, so that the ground can say who is prime once it has been heard.
    """
    switches_us = [reported_us for reported_us, _source in world.source_switches]
    cuts_us = [version.reported_us for version in world.plan_versions[1:]]
    cuts_us += [cut for reported_us in switches_us for cut in (reported_us, reported_us + world.scenario.row_period_us)]
    chunks = []
    for phase in world.scenario.phases:
        inside_us = [cut for cut in cuts_us if phase.start_us < cut < phase.stop_us]
        edges = np.searchsorted(world.rows.epochs_us, [phase.start_us, *sorted(inside_us), phase.stop_us]).tolist()
        for begin, end in pairwise(edges):
            rows = range(begin, end, rows_per_chunk)
            chunks += [(row, min(row + rows_per_chunk, end) - 1, phase.name) for row in rows]
    return chunks


def flown_chunks_of(world: World, rows_per_chunk: int = ROWS_PER_CHUNK) -> list[tuple[int, int, str]]:
    """Return the chunks of a world that is flown: in operation each ends with the only row in it that is measured.

    Rows without a measurement at the very end belong to none.
    """
    chunks = [chunk for chunk in chunks_of(world, rows_per_chunk) if chunk[2] != "operation"]
    first = int(np.searchsorted(world.rows.epochs_us, world.scenario.operation_start_us))
    for row in (first + np.flatnonzero(~world.rows.is_gap[first:])).tolist():
        chunks.append((first, row, "operation"))
        first = row + 1
    return chunks


def catalogue_lines(world: World, *, is_flown: bool = False) -> Iterator[Line]:
    """Yield what is known before the first row: spacecraft, carriers, task, ephemeris, and for the judge the bound."""
    yield {"kind": "spacecraft", "body": spacecraft_body(world, is_flown=is_flown)}
    yield from _plan_lines(world, world.plan_versions[0].carriers)
    yield {"kind": "ephemeris", "body": ephemeris_body(world, world.ephemerides[0])}
    yield {"kind": "bound", "crlb_deg": _bound(world)}


def events(world: World, start_us: int = -(2**63), stop_us: int = 2**63 - 1) -> Iterator[tuple[int, Line]]:
    """Yield what the ground learns in [start, stop) beside references and timely corrections, with the epochs.

    Plans with their tasks, ephemerides, operations, the analyzer that measures from now on, records of sensors, and
    corrections told too late.
    """
    for reported_us, make in _all_events(world):
        if start_us <= reported_us < stop_us:
            yield from ((reported_us, line) for line in make())


def _all_events(world: World) -> Iterator[tuple[int, Callable[[], Iterator[Line]]]]:
    """Yield all news with what makes their lines: a track is long and wanted once."""
    for version in world.plan_versions[1:]:
        yield version.reported_us, partial(_plan_lines, world, version.carriers)
    for ephemeris in world.ephemerides[1:]:
        yield ephemeris.reported_us, partial(_line, "ephemeris", ephemeris_body, world, ephemeris)
    for operation in world.operations:
        yield operation.reported_us, partial(_line, "operations", operation_body, operation)
    for reported_us, source in world.source_switches:
        yield reported_us, partial(_line, "source", dict, source=source)
    yield from _sensor_events(world)
    for correction in world.corrections:
        if correction.is_late:
            yield correction.reported_us, partial(_line, "corrections", corrections_body, [correction])


def _sensor_events(world: World) -> Iterator[tuple[int, Callable[[], Iterator[Line]]]]:
    """Yield the records of telemetry and of the polarimeter."""
    for record in world.telemetry:
        yield record.reported_us, partial(_line, "telemetry", telemetry_body, record)
    for report in world.polarization:
        yield report.reported_us, partial(_line, "polarization", polarization_body, report)


def _line(kind: str, make_body: Callable[..., Line], *arguments: object, **fields: object) -> Iterator[Line]:
    yield {"kind": kind, "body": make_body(*arguments, **fields)}


def _plan_lines(world: World, carriers: tuple[Carrier, ...]) -> Iterator[Line]:
    yield {"kind": "carriers", "body": {"carriers": [carrier_body(world, carrier) for carrier in carriers]}}
    yield {"kind": "task", "body": task(world, carriers)}


def _bound(world: World) -> dict[str, float]:
    """Return the one-row bound of the true beams with a common unknown for the first plan's carriers, deg."""
    columns = [world.plan.column(carrier.id) for carrier in world.plan_versions[0].carriers]
    bound_deg = crlb_deg(sensitivity_db_per_deg(world.plan, world.orbit)[columns])
    return {axis: round(float(value), 6) for axis, value in zip(AXES, bound_deg, strict=True)}


def chunk_lines(world: World, first: int, last: int) -> Iterator[Line]:
    """Yield what belongs to the rows first..last, both inclusive."""
    yield from reported_lines(world, first, last)
    yield {"kind": "truth", "rows": truth_rows(world, first, last)}


def reported_lines(world: World, first: int, last: int) -> Iterator[Line]:
    """Yield what the ground is told with the rows first..last: all but the truth."""
    epochs_us = world.rows.epochs_us
    start_us, stop_us = int(epochs_us[first]), int(epochs_us[last]) + world.scenario.row_period_us
    yield from _chunk_events(world, first, last)
    for phase in world.scenario.phases:
        if start_us <= phase.start_us < stop_us:
            yield _phase(phase)
            if phase.name == "turns":
                yield from ({"kind": "operations", "body": operation} for operation in turn_operations(phase))
    yield from ({"kind": "references", "body": body} for body in reference_bodies(world, start_us, stop_us))
    timely = [c for c in world.corrections if start_us <= c.start_us < stop_us and not c.is_late]
    if timely:
        yield {"kind": "corrections", "body": corrections_body(timely)}


def flown_lines(world: World, first: int, last: int) -> Iterator[Line]:
    """Yield what the ground is told with the rows first..last where torques are flown, without the reports on board."""
    yield from (line for line in reported_lines(world, first, last) if line["kind"] not in _NOT_FLOWN)


def _chunk_events(world: World, first: int, last: int) -> Iterator[Line]:
    """Yield what is known when the last row of a chunk is swept and was not when the row before the chunk was."""
    epochs_us = world.rows.epochs_us
    start_us = int(epochs_us[first - 1]) + 1 if first else world.scenario.start_us
    yield from (line for _reported_us, line in events(world, start_us, int(epochs_us[last]) + 1))


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
                    "comment": json.dumps(angles(turn.attitude_deg)),
                }
            )
    return operations


def truth_rows(world: World, first: int, last: int) -> list[Line]:
    """Return the truth of the rows first..last; for the judge alone."""
    return [truth_row(world, row, world.rows.attitude_deg[row]) for row in range(first, last + 1)]


def truth_row(world: World, row: int, attitude_deg: FloatArray | Iterable[float]) -> Line:
    """Return the truth of a row at an attitude, which in closed loop is not the story's."""
    rows = world.rows
    line = {
        "epoch": rfc3339(int(rows.epochs_us[row])),
        **angles(attitude_deg),
        "downlink_fade_db": round(float(rows.downlink_fade_db[row]), 6),
        "chain_db": round(float(rows.chain_db[row]), 6),
    }
    if rows.is_gap[row]:
        line["is_gap"] = True
    flags = zip(world.carrier_ids, rows.flags[row].tolist(), strict=True)
    faults = {name: [flag.name.lower() for flag in FaultFlag(bits) if flag.name] for name, bits in flags if bits}
    return {**line, "faults": faults} if faults else line


def _phase(phase: Phase) -> Line:
    return {"kind": "phase", "name": phase.name, "start": rfc3339(phase.start_us), "stop": rfc3339(phase.stop_us)}
