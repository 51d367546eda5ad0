"""Documents of the results of one carrier, row by row."""

from typing import Any, Self

from service.api.schemas.base import Answer, EpochAnswer, Figure, RowPage
from service.records.catalogue import Method
from service.records.levels.attitude import AttitudeRow
from service.records.levels.carrier_results import CARRIER_HYPOTHESES, CARRIER_STATES, CarrierResults


class CarrierResultAnswer(Answer):
    """Results of one carrier at one measurement, by one method."""

    epoch: EpochAnswer
    state: str | None
    """used, absent, excluded, unselected or uncalibrated; null where nothing is stored: the carrier is not in the plan
    of the row, the row was late, or nothing was computed for it."""
    reason: str | None
    """Why it is left out, as in `excluded` of the attitude row."""
    deviation_db: Figure
    """Measured minus expected, to 0.002 dB; null = absent or not used."""
    residual_db: Figure
    """Deviation minus what the attitude explains, to 0.002 dB."""
    hypothesis: str | None
    """Likeliest state by the references of the alignment: dry, wet, level_changed or level_learned."""
    plan_id: int | None

    @classmethod
    def of(cls, row: AttitudeRow, results: CarrierResults | None, position: int | None, carrier: str) -> Self:
        """Return the answer for the carrier at one place of a row's plan; None: nothing is known of it."""
        reason = next((each.reason for each in row.excluded if each.carrier == carrier), None)
        known: dict[str, Any] = dict.fromkeys(("state", "deviation_db", "residual_db", "hypothesis", "plan_id"))
        if results is not None and position is not None:
            known = {
                "state": CARRIER_STATES[results.state[position]],
                "deviation_db": round(float(results.deviation_db[position]), 3),
                "residual_db": round(float(results.residual_db[position]), 3),
                "hypothesis": CARRIER_HYPOTHESES[results.hypothesis[position]],
                "plan_id": results.plan_id,
            }
        return cls.model_validate({"epoch": row.epoch_us, "reason": reason, **known})


class CarrierResultPage(RowPage):
    """Rows in order of epoch, exactly one a measurement and method."""

    carrier: str
    method: Method
    version: str
    rows: list[CarrierResultAnswer]
