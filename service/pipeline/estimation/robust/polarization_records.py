"""Angles of polarimeters on their way to the filter: a block of some minutes is taken with the row after it."""

import math
from dataclasses import replace

import numpy as np

from service.core.estimation.filtering.model.hidden_motion import momentum_count, sensors_first
from service.core.estimation.filtering.model.polarimeter import POLARIMETER
from service.core.estimation.filtering.watches.polarimeter_watch import PolarimeterWatch, push_block
from service.core.geometry.line_of_sight import PredictedTrack, frame_turn_deg
from service.pipeline.estimation.robust.method import RobustState
from service.pipeline.estimation.robust.model import RobustModel
from service.pipeline.inputs.knowledge import Knowledge
from service.pipeline.inputs.polarization import due_block, used_polarimeters


def with_polarization(state: RobustState, model: RobustModel, knowledge: Knowledge) -> RobustState:
    """Return the state after the blocks of the polarimeters that are due at its epoch."""
    settings, epoch_us = model.settings, state.filter.epoch_us
    if not settings.polarimeters:
        return state
    gaussian = state.filter.gaussian
    first = sensors_first(model.filter, gaussian, settings) + momentum_count(settings)
    watches = list(state.polarimeters or (PolarimeterWatch(),) * len(settings.polarimeters))
    for number, stated in enumerate(used_polarimeters(knowledge.spacecraft)):
        read = settings.polarimeters[number]
        block = due_block(knowledge.polarization.get(stated.source, ()), stated, watches[number].newest_us, epoch_us)
        if block is None:
            continue
        block = block._replace(angle_deg=block.angle_deg - orbit_turn_deg(knowledge, read.sight, block.epoch_us))
        if math.isfinite(block.angle_deg):
            watches[number], gaussian = push_block(
                watches[number], gaussian, first + POLARIMETER * number, block, epoch_us, read
            )
    return replace(state, filter=state.filter._replace(gaussian=gaussian), polarimeters=tuple(watches))


def orbit_turn_deg(knowledge: Knowledge, sight: tuple[float, float, float], epoch_us: int) -> float:
    """Return what the orbit turns a body about a line of sight, deg; 0 without a track, NaN where it does not reach."""
    if knowledge.ephemeris is None or knowledge.ephemeris.track is None or knowledge.spacecraft is None:
        return 0.0
    reported = knowledge.ephemeris.track
    track = PredictedTrack(
        np.array(reported.epochs_us, dtype=np.int64), np.array(reported.latitude_deg), np.array(reported.longitude_deg)
    )
    turn_deg = frame_turn_deg(track, np.array([epoch_us], dtype=np.int64), knowledge.spacecraft.longitude_deg)
    return float(turn_deg[0] @ np.array(sight))
