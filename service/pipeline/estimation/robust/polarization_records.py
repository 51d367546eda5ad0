"""Angles of polarimeters on their way to the filter: a block of some minutes is taken with the row after it."""

import math
from dataclasses import replace

import numpy as np

from service.core.estimation.filtering.model.hidden_motion import momentum_count, sensors_first
from service.core.estimation.filtering.model.polarimeter import POLARIMETER
from service.core.estimation.filtering.model.sensor_effect import SensorEffect
from service.core.estimation.filtering.watches.polarimeter_watch import PolarimeterWatch, push_block
from service.pipeline.estimation.robust.method import RobustState
from service.pipeline.estimation.robust.model import RobustModel
from service.pipeline.inputs.knowledge import Knowledge
from service.pipeline.inputs.polarization import due_block, orbit_turn_deg


def with_polarization(
    state: RobustState, model: RobustModel, knowledge: Knowledge
) -> tuple[RobustState, list[SensorEffect]]:
    """Return the state after the blocks of the polarimeters that are due at its epoch, and the effect of each."""
    settings, epoch_us = model.settings, state.filter.epoch_us
    if knowledge.spacecraft is None or not settings.polarimeters:
        return state, []
    gaussian, effects = state.filter.gaussian, []
    first = sensors_first(model.filter, gaussian, settings) + momentum_count(settings)
    watches = list(state.polarimeters or (PolarimeterWatch(epoch_us),) * len(settings.polarimeters))
    for number, stated in enumerate(model.polarimeters):
        read = settings.polarimeters[number]
        block = due_block(knowledge.polarization.get(stated.source, ()), stated, watches[number].newest_us, epoch_us)
        if block is None:
            continue
        at_us = np.array([block.epoch_us], dtype=np.int64)
        turned_deg = orbit_turn_deg(knowledge.ephemeris, knowledge.spacecraft, read.sight, at_us)
        block = block._replace(angle_deg=block.angle_deg - float(turned_deg[0]))
        if math.isfinite(block.angle_deg):
            watches[number], gaussian, effect = push_block(
                watches[number], gaussian, first + POLARIMETER * number, block, epoch_us, read
            )
            effects.append(effect)
    if effects or not state.polarimeters:
        state = replace(state, filter=state.filter._replace(gaussian=gaussian), polarimeters=tuple(watches))
    return state, effects
