"""Results of each carrier at one row, beside the attitude row (L2 and L3 carrier by carrier)."""

from dataclasses import dataclass

from service.records.levels.attitude import FloatArray, IntArray

#: dB, in which levels are stored and published; half of it is the error of rounding
STEP_DB = 0.004
#: stored as their positions, so a new state or hypothesis stands at the end
CARRIER_STATES = ("used", "absent", "excluded", "unselected", "uncalibrated")
CARRIER_HYPOTHESES = (None, "dry", "wet", "level_changed", "level_learned")


@dataclass(frozen=True, slots=True, eq=False)
class CarrierResults:
    """Results of the N carriers of a plan at one row, in the order of the plan; arrays are (N,)."""

    plan_id: int
    #: dB, measured minus expected; NaN = absent or not used
    deviation_db: FloatArray
    #: dB, deviation minus what the attitude explains; NaN = not known
    residual_db: FloatArray
    #: positions in `CARRIER_STATES`
    state: IntArray
    #: positions in `CARRIER_HYPOTHESES`
    hypothesis: IntArray
