"""Advice about measured motion: what a row says of telemetry and polarimeters that it cannot use."""

from service.core.estimation.filtering.watches.momentum_watch import MomentumWatch, momentum_advice
from service.core.estimation.filtering.watches.rate_watch import RateWatch
from service.pipeline.estimation.robust.model import RobustModel
from service.pipeline.inputs.knowledge import Knowledge


def telemetry_advice(
    model: RobustModel, knowledge: Knowledge, momentum: MomentumWatch, rates: RateWatch, since_us: int, epoch_us: int
) -> dict[str, bool]:
    """Return which advice is given at an epoch of a filter that began at another."""
    return {
        **dict.fromkeys(sorted(model.contradicted), True),
        **momentum_advice(momentum, since_us, epoch_us, is_used=model.settings.momentum is not None),
        "rates_refused": rates.is_refused,
        "rates_in_loop": model.is_rate_in_loop and knowledge.has_rate(epoch_us),
    }
