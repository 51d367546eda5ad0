"""Planned attitude of the operation phase: holds with cosine slews, and the pieces in which it is commanded."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from analyzer_sim.streams import FloatArray, stream
from analyzer_sim.world.scenario.events import FalseReport, Hold, Manoeuvre, Range, Tour

#: a slew is commanded in pieces no longer than this, a hold in pieces no longer than that, s
SLEW_CHUNK_S = 300.0
HOLD_CHUNK_S = 1800.0


def holds_of(manoeuvres: Sequence[Manoeuvre], seed: int, operation_h: float) -> tuple[Hold, ...]:
    """Return all holds of the phase, with what a tour leaves open drawn from its stream."""
    holds: list[Hold] = []
    for manoeuvre in manoeuvres:
        if isinstance(manoeuvre, Hold):
            holds.append(manoeuvre)
        elif isinstance(manoeuvre, FalseReport):
            holds.append(_reported_hold(manoeuvre, seed, manoeuvre.executed_share))
        else:
            holds.extend(_tour_holds(manoeuvre, seed, operation_h))
    return tuple(holds)


def unexecuted_deg(manoeuvres: Sequence[Manoeuvre], seed: int, hours: FloatArray) -> FloatArray:
    """Return how far (T, 3) the announced attitude has run ahead of the executed one by false reports, deg."""
    lead = np.zeros((len(hours), 3))
    for report in manoeuvres:
        if isinstance(report, FalseReport):
            missing = _reported_hold(report, seed, 1.0 - report.executed_share)
            share = _ramp(hours, report.start_h, report.duration_h)
            lead += share[:, None] * np.array([missing.yaw_deg, missing.roll_deg, missing.pitch_deg])
    return lead


def _reported_hold(report: FalseReport, seed: int, share: float) -> Hold:
    """Return this share of the announced hold; its signs are drawn once."""
    signs = stream(seed, "false report", report.name).choice([-1.0, 1.0], size=3)
    yaw, roll, pitch = (share * signs * [report.yaw_deg, report.roll_deg, report.pitch_deg]).tolist()
    return Hold(report.start_h, report.hold_h, 60.0 * report.duration_h, yaw, roll, pitch)


def _tour_holds(tour: Tour, seed: int, operation_h: float) -> list[Hold]:
    """Draw octants in shuffled rounds of eight; each hold ends where the next slew begins."""
    rng = stream(seed, "tour", tour.name)
    holds: list[Hold] = []
    start_h = tour.start_h
    order: list[int] = []
    while True:
        order = order or rng.permutation(8).tolist()
        octant = order.pop()
        signs = [1.0 if octant & bit else -1.0 for bit in (4, 2, 1)]
        yaw, roll, pitch = (
            sign * _draw(rng, limits)
            for sign, limits in zip(signs, (tour.yaw_deg, tour.roll_deg, tour.pitch_deg), strict=True)
        )
        hold_h, slew_min = _draw(rng, tour.hold_h), _draw(rng, tour.slew_min)
        if start_h + hold_h + slew_min / 60.0 > operation_h:
            return holds
        holds.append(Hold(start_h, hold_h, slew_min, yaw, roll, pitch))
        start_h += hold_h + slew_min / 60.0


def _draw(rng: np.random.Generator, limits: Range) -> float:
    return float(rng.uniform(*limits))


def planned_deg(holds: Sequence[Hold], hours: FloatArray) -> FloatArray:
    """Return the planned attitude (T, 3) at hours from the start of operation, deg."""
    plan = np.zeros((len(hours), 3))
    for hold in holds:
        slew_h = hold.slew_min / 60.0
        share = _ramp(hours, hold.start_h, slew_h) - _ramp(hours, hold.start_h + hold.hold_h, slew_h)
        plan += share[:, None] * np.array([hold.yaw_deg, hold.roll_deg, hold.pitch_deg])
    return plan


def _ramp(hours: FloatArray, start_h: float, slew_h: float) -> FloatArray:
    """Return a cosine rise from 0 to 1."""
    share = np.clip((hours - start_h) / slew_h, 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * share))


def chunk_edges(holds: Sequence[Hold], row_count: int, row_period_s: float) -> NDArray[np.int64]:
    """Return the rows, counted from the start of operation, at which one commanded piece ends and the next begins."""
    slews = [
        (start_h * 3600.0, (start_h + hold.slew_min / 60.0) * 3600.0)
        for hold in holds
        for start_h in (hold.start_h, hold.start_h + hold.hold_h)
    ]
    corners = sorted({0.0, row_count * row_period_s, *(corner for slew in slews for corner in slew)})
    edges: set[int] = set()
    for begin_s, end_s in pairwise(corners):
        middle_s = 0.5 * (begin_s + end_s)
        is_slew = any(first_s < middle_s < last_s for first_s, last_s in slews)
        count = int(np.ceil((end_s - begin_s) / (SLEW_CHUNK_S if is_slew else HOLD_CHUNK_S)))
        edges.update(int(row) for row in np.round(np.linspace(begin_s, end_s, count + 1) / row_period_s))
    return np.array(sorted(edge for edge in edges if 0 <= edge <= row_count), dtype=np.int64)
