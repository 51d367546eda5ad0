"""Ground: everything the ground knows about a world, as JSON objects shaped like the bodies of the service's interface.

Each object is a line `{"kind": ..., "body": {...}}`; `phase` and `truth` lines have no body. A `truth` line is for the
judge alone and must never be forwarded. Nothing here is known from the powers.
"""

import json
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import pairwise

import numpy as np

from analyzer_sim.epochs import US_PER_S, rfc3339
from analyzer_sim.streams import FloatArray
from analyzer_sim.world.ground.ground_bodies import (
    AXES,
    Line,
    angles,
    carrier_body,
    corrections_body,
    ephemeris_body,
    operation_body,
    polarization_body,
    reference_bodies,
    spacecraft_body,
    task,
    telemetry_body,
)
from analyzer_sim.world.payload.carriers import Carrier
from analyzer_sim.world.payload.effects import FaultFlag
from analyzer_sim.world.payload.level_terms import sensitivity_db_per_deg
from analyzer_sim.world.scenario.story import SLEW_MIN, TIMETABLE, Phase
from analyzer_sim.world.structure import crlb_deg
from analyzer_sim.world.world import World

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
