"""Facts of a row for the interlock."""

from service.pipeline.control.release.interlock_conditions import interlock_row
from service.records.catalogue import Method
from service.records.levels.attitude import row_without_attitude


def test_a_row_without_attitude_says_so():
    row = row_without_attitude(5_000_000, 5_100_000, 1, Method.ROBUST, ("no_fix",))
    facts = interlock_row(row, 60.0, is_innovation_in_band=True)
    assert (facts.epoch_us, facts.period_s, facts.redundancy) == (5_000_000, 60.0, -3)
    assert facts.inhibitions == ("no_fix", "invalid")
