"""Lines of the plant: the dialogue over a pair of text streams, one JSON object a line.

Out, in this order; fields in brackets are not always there:

    {"type":"start","scenario":..,"seed":..,"carriers":[ids],"open_rows":n,"closed_rows":m,"uplink":..,"slowest_s":..,
     "onboard":..,"fed_forward_torque":{"epoch":..,"period_s":..,"constant_n_m":{..},"cosine_n_m":{..},"sine_n_m":{..}}}
    {"type":"ground","line":{..}}                what the ground port would send, corrections left out
    {"type":"report","counter":..,"state":"executed|executing|replaced|repeated|late|refused","told":..,"received":..,
     ["executed_from":..,"executed_until":..,"impulse_n_m_s":{..}]}
    {"type":"truth","epoch":..,"yaw_deg":..,..}  for the judge alone
    {"type":"row","epoch":..,"power_dbm":[..]}   null = absent; rows of a gap are left out
    {"type":"end"}

Quiet phase, turns and alignment run through without an answer. In operation each row is preceded by a telemetry
record of its own (a ``ground`` line: momentum and speed of the wheels, rate of the body as the model on board has it)
and by the reports of commands since the row before; of a command that was lost there is none. After each row of
operation the plant waits for one line

    {"schedule":[{"start":..,"duration_s":..,"roll_n_m":..,"pitch_n_m":..,"yaw_n_m":..},..],["counter":..],
     ["attitude":{"counter":..,"attitude_epoch":..,"valid_until":..,"attitude_deg":{..}}]}

An attitude is for the loop on board of `--age-limit`. Elements begin not before the row. Without a counter the plant
counts the schedules that are not empty. A line that is not understood is answered by `{"type":"error","detail":..}`,
changes nothing, and another one is awaited. The end of standard input ends the plant.
"""

import json
import math
from collections.abc import Iterator
from typing import Any, TextIO

import numpy as np

from analyzer_sim.epochs import rfc3339
from analyzer_sim.plant.plant import MAX_LINE_CHARACTERS, Plant, Schedule, ScheduleError, parse_schedule
from analyzer_sim.streams import FloatArray, stream
from analyzer_sim.world.ground.ground import catalogue_lines, chunks_of, flown_lines, reported_lines, truth_row
from analyzer_sim.world.spacecraft.body import rotor_speed_rpm
from analyzer_sim.world.spacecraft.telemetry import PERIOD_H, fed_forward, with_errors
from analyzer_sim.world.spacecraft.uplink import Report
from analyzer_sim.world.world import World

Line = dict[str, Any]

_AXES = ("yaw", "roll", "pitch")
_US_PER_H = 3_600_000_000


def run_plant(plant: Plant, source: TextIO, sink: TextIO) -> int:
    """Play a plant over a pair of text streams and return the exit status.

    Raises
    ------
    BrokenPipeError
        The reader has left.
    """
    _send(sink, _opening(plant))
    while True:
        _send(sink, _present(plant))
        schedule = _await_schedule(plant, source, sink) if plant.is_measured else Schedule(())
        if schedule is None:
            return 0
        if not plant.advance(schedule):
            _send(sink, iter([{"type": "end"}]))
            return 0


def _opening(plant: Plant) -> Iterator[Line]:
    """Yield everything before operation."""
    world, options = plant.world, plant.options
    rows = {"open_rows": plant.first_row, "closed_rows": plant.row_count - plant.first_row}
    what = {"uplink": options.uplink, "slowest_s": plant.uplink.figures.latency_s[1], "onboard": options.onboard}
    carriers = list(world.carrier_ids)
    reported = {"fed_forward_torque": fed_forward_line(world)}
    start = {"type": "start", "scenario": world.scenario.name, "seed": world.seed, "carriers": carriers}
    yield {**start, **rows, **what, **reported}
    yield from ({"type": "ground", "line": line} for line in catalogue_lines(world, is_flown=True))
    for first, last, phase in chunks_of(world):
        if phase != "operation":
            yield from ({"type": "ground", "line": line} for line in reported_lines(world, first, last))
            for row in range(first, last + 1):
                yield {"type": "truth", **truth_row(world, row, world.rows.attitude_deg[row])}
                yield _row_line(int(world.rows.epochs_us[row]), plant.open_dbm[row])


def fed_forward_line(world: World) -> Line | None:
    """Return the profile that the loop on board feeds forward, as the catalogue states one; None = it is not known."""
    if not world.scenario.is_torque_stated:
        return None
    reported = fed_forward(world.scenario, world.seed)
    parts = {"constant_n_m": reported.constant_n_m, "cosine_n_m": reported.cosine_n_m, "sine_n_m": reported.sine_n_m}
    torques = {name: dict(zip(_AXES, part.tolist(), strict=True)) for name, part in parts.items()}
    return {"epoch": rfc3339(reported.epoch_us), "period_s": reported.period_s, **torques}


def _present(plant: Plant) -> Iterator[Line]:
    """Yield what belongs to the present row of operation."""
    yield from ({"type": "ground", "line": line} for line in flown_lines(plant.world, plant.row, plant.row))
    yield {"type": "ground", "line": {"kind": "telemetry", "body": {"records": [telemetry_of(plant)]}}}
    yield from (report_line(report) for report in plant.reports)
    rates = dict(zip(_AXES, plant.state.rate_deg_s, strict=True))
    truth = truth_row(plant.world, plant.row, plant.state.attitude_deg)
    held = {} if plant.loop is None else {"is_holding": plant.loop.is_holding(plant.epoch_us)}
    yield {"type": "truth", **truth, "rates_deg_s": rates, **held}
    if plant.is_measured:
        yield _row_line(plant.epoch_us, plant.power_dbm())


def telemetry_of(plant: Plant) -> Line:
    """Return what the spacecraft says of itself; its inertial model does not see the drift of its rate."""
    reported = plant.reported_telemetry()
    x, y, z = (math.degrees(rate) for rate in plant.flown.commanded_rad_s)
    return {
        "epoch": rfc3339(plant.epoch_us),
        "onboard_mode": reported.onboard_mode,
        **_momentum_of(plant),
        "body_rate_deg_s": {"yaw": round(z, 9), "roll": round(x, 9), "pitch": round(y, 9)},
    }


def _momentum_of(plant: Plant) -> Line:
    """Return what the spacecraft says of its wheels: with each row, or as often as the story says."""
    momentum, reported, figures = plant.momentum_n_m_s, plant.reported_telemetry(), plant.world.scenario.wheels
    is_active = reported.thrusters_active
    if figures is None:
        is_active = is_active and plant.epoch_us - reported.reported_us < PERIOD_H * _US_PER_H // 2
    elif reported.reported_us != plant.epoch_us:
        return {}
    else:
        noise = stream(plant.world.seed, "wheel noise", str(plant.row)).normal(size=3)
        momentum = with_errors(figures, plant.world.seed, np.array(momentum), noise).tolist()
    return {
        "wheel_momentum_n_m_s": [round(h, 6) for h in momentum],
        "wheel_speed_rpm": [round(rotor_speed_rpm(h), 3) for h in momentum],
        "thrusters_active": is_active,
    }


def report_line(report: Report) -> Line:
    """Return what the spacecraft tells of a command."""
    line: Line = {
        "type": "report",
        "counter": report.counter,
        "state": report.fate.value,
        "told": rfc3339(report.reported_us),
        "received": rfc3339(report.received_us),
    }
    if report.executed_us is not None:
        line["executed_from"], line["executed_until"] = (rfc3339(epoch_us) for epoch_us in report.executed_us)
        line["impulse_n_m_s"] = dict(zip(_AXES, report.impulse_n_m_s, strict=True))
    return line


def _row_line(epoch_us: int, power_dbm: FloatArray) -> Line:
    levels = [None if math.isnan(level) else round(level, 5) for level in power_dbm.tolist()]
    return {"type": "row", "epoch": rfc3339(epoch_us), "power_dbm": levels}


def _await_schedule(plant: Plant, source: TextIO, sink: TextIO) -> Schedule | None:
    """Return the next schedule; None at the end of the input."""
    while text := source.readline(MAX_LINE_CHARACTERS + 1):
        try:
            if len(text) > MAX_LINE_CHARACTERS:
                _skip_line(text, source)
            return parse_schedule(text, plant.epoch_us)
        except ScheduleError as error:
            _send(sink, iter([{"type": "error", "detail": str(error)}]))
    return None


def _skip_line(text: str, source: TextIO) -> None:
    """Read the rest of a line that is too long."""
    while text and not text.endswith("\n"):
        text = source.readline(MAX_LINE_CHARACTERS)


def _send(sink: TextIO, lines: Iterator[Line]) -> None:
    for line in lines:
        sink.write(json.dumps(line, allow_nan=False, separators=(",", ":")) + "\n")
    sink.flush()
