"""Records of the rate of the body on their way to the filter: each is used once, with the first row after it."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from service.core.estimation.filtering.model.measured_motion import measured_settings
from service.core.estimation.filtering.watches.rate_watch import HELD_US, MovingState, commanded_rate, push_rates
from service.pipeline.estimation.robust.method import RobustState
from service.pipeline.estimation.robust.model import RobustModel
from service.pipeline.inputs.knowledge import Knowledge, records_between
from service.pipeline.inputs.known_motion import consume
from service.pipeline.inputs.telemetry_rates import inertial_deg_h

_US_PER_H = 3.6e9


def with_rates(
    state: RobustState, model: RobustModel, knowledge: Knowledge, to_us: int
) -> tuple[RobustState, RobustModel]:
    """Return state and model for the step up to an epoch: that of the measured rate where one is known."""
    sensor, watch, from_us = model.rate_sensor, state.rates, state.filter.epoch_us
    if sensor is None or watch.is_refused or to_us <= from_us:
        return state, model
    before = MovingState(from_us, state.filter.gaussian, state.filter.drift, state.filter.command)
    known, _ = consume(state.commanded, from_us, to_us)
    commanded = commanded_rate(watch, before) + known.correction_deg * (_US_PER_H / (to_us - from_us))
    records = records_between(knowledge.rates, max(watch.newest_us, from_us - HELD_US), to_us)
    watch, moved = push_rates(
        watch,
        before,
        np.array([one.epoch_us for one in records], dtype=np.int64),
        inertial_deg_h([one.body_rate_deg_s for one in records if one.body_rate_deg_s is not None]),
        to_us,
        commanded,
        model.settings,
        sensor,
        is_pushed=bool(known.rate_change_deg_h.any() or state.released),
    )
    state = replace(state, filter=state.filter._replace(**moved._asdict()), rates=watch)
    if not watch.is_measured:
        return state, model
    return state, _under_rates(model)


@lru_cache(maxsize=64)
def _under_rates(model: RobustModel) -> RobustModel:
    """Return the model of a step whose rate is measured."""
    sensor = model.rate_sensor
    return model if sensor is None else replace(model, settings=measured_settings(model.settings, sensor))
