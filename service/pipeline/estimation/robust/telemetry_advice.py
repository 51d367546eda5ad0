"""Advice about telemetry of the wheels and of the rates of the body: what a row says of records that it cannot use."""

from service.core.estimation.filtering.watches.momentum_watch import MomentumWatch, momentum_advice
from service.core.estimation.filtering.watches.rate_watch import RateWatch, rate_advice
from service.pipeline.estimation.robust.model import RobustModel
from service.pipeline.inputs.knowledge import Knowledge


def telemetry_advice(
    model: RobustModel, knowledge: Knowledge, momentum: MomentumWatch, rates: RateWatch, since_us: int, epoch_us: int
) -> dict[str, bool]:
    """Return which advice is given at an epoch of a filter that began at another."""
    is_used = model.settings.momentum is not None
    is_in_loop = model.is_rate_in_loop and knowledge.has_rate(epoch_us)
    return {
        "momentum_contradicted": model.is_momentum_contradicted,
        **momentum_advice(momentum, since_us, epoch_us, is_used=is_used),
        **rate_advice(rates, is_contradicted=model.is_rates_contradicted, is_in_loop=is_in_loop),
    }
