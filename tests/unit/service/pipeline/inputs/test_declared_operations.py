"""Declared operations: which carriers are not believed, and what may have moved by how much on one step."""

import numpy as np
import pytest

from service.pipeline.config import OperationConfig
from service.pipeline.inputs.declared_operations import CarrierIndices, declared_between, with_chain_step
from service.records.inputs import Operation
from service.records.levels.attitude import Axes

S = 1_000_000
MINUTE, HOUR = 60 * S, 3600 * S
CONFIG = OperationConfig()
NAMES = CarrierIndices(("a", "b", "c", "d"), ("K1", "K2"), np.array([0, 0, 1, 1]))
#: shares of hours, divided and multiplied again
EXACT = 1e-12


def operation(kind, start_us=2 * HOUR, stop_us=3 * HOUR, **changes):
    return Operation(1, kind, start_us, stop_us, **changes)


def reported(kind, from_us, to_us, **changes):
    return declared_between((operation(kind, **changes),), NAMES, from_us, to_us, CONFIG)


@pytest.mark.parametrize(
    "kind",
    [
        "station_keeping",
        "momentum_unloading",
        "eclipse",
        "sun_outage",
        "carrier_work",
        "gain_change",
        "receive_chain_work",
        "calibration_turn",
        "other",
    ],
)
def test_before_and_after_an_operation_nothing_is_declared(kind):
    assert reported(kind, HOUR, 2 * HOUR - S) is None
    assert reported(kind, 5 * HOUR, 5 * HOUR + MINUTE) is None
    assert declared_between((), NAMES, 0, HOUR, CONFIG) is None


@pytest.mark.parametrize(
    ("kind", "usual_deg"),
    [("station_keeping", 0.1), ("momentum_unloading", 0.05), ("calibration_turn", 0.5), ("other", 0.0)],
)
def test_an_operation_that_turns_the_craft_lets_it_walk_to_its_uncertainty(kind, usual_deg):
    steps = np.arange(HOUR, 4 * HOUR + 1, 7 * MINUTE)
    variance = np.zeros(3)
    for from_us, to_us in zip(steps[:-1].tolist(), steps[1:].tolist(), strict=True):
        declared = reported(kind, from_us, to_us)
        if declared is not None:
            variance += declared.attitude_walk_deg**2 * (to_us - from_us) / HOUR
            assert not declared.is_masked.any()
            assert not declared.attitude_step_deg.any()
    np.testing.assert_allclose(np.sqrt(variance), usual_deg, atol=EXACT)


def test_a_stated_uncertainty_replaces_the_usual_one_axis_by_axis():
    stated = Axes(0.3, float("nan"), 0.2)
    declared = reported("station_keeping", 2 * HOUR, 3 * HOUR, attitude_uncertainty_deg=stated)
    np.testing.assert_allclose(declared.attitude_walk_deg, [0.3, 0.0, 0.2], atol=EXACT)


def test_an_operation_without_end_spreads_its_uncertainty_over_an_hour_and_goes_on():
    declared = reported("momentum_unloading", 20 * HOUR, 20 * HOUR + MINUTE, stop_us=None)
    np.testing.assert_allclose(declared.attitude_walk_deg, 0.05, atol=EXACT)


def test_a_short_burn_within_one_step_leaves_all_of_its_uncertainty():
    declared = reported("station_keeping", HOUR, 5 * HOUR, stop_us=2 * HOUR + MINUTE)
    np.testing.assert_allclose(declared.attitude_walk_deg * 2.0, 0.1, atol=EXACT)
    instant = reported("station_keeping", HOUR, 5 * HOUR, stop_us=2 * HOUR)
    np.testing.assert_array_equal(instant.attitude_walk_deg, 0.0)


def test_an_eclipse_moves_transponders_and_levels_until_an_hour_after():
    during = reported("eclipse", 2 * HOUR, 2 * HOUR + 30 * MINUTE)
    np.testing.assert_allclose(during.group_step_db, 0.3 * np.sqrt(0.5), atol=EXACT)
    np.testing.assert_allclose(during.reference_walk_db, 0.06, atol=EXACT)
    np.testing.assert_array_equal(during.attitude_walk_deg, 0.0)
    warming = reported("eclipse", 3 * HOUR + 30 * MINUTE, 5 * HOUR, transponders=("K2",))
    np.testing.assert_allclose(warming.group_step_db, [0.0, 0.3 * np.sqrt(0.5)], atol=EXACT)
    assert reported("eclipse", 4 * HOUR, 5 * HOUR) is None
    assert not during.is_masked.any()
    stated = reported("eclipse", 2 * HOUR, 3 * HOUR, attitude_uncertainty_deg=Axes(0.0, 0.06, 0.0))
    np.testing.assert_allclose(stated.attitude_walk_deg, [0.0, 0.06, 0.0], atol=EXACT)
    assert reported("eclipse", 9 * HOUR, 10 * HOUR, stop_us=None).group_step_db[0] == pytest.approx(0.3, abs=EXACT)


@pytest.mark.parametrize(
    ("named", "masked"),
    [
        pytest.param({}, [1, 1, 1, 1], id="all"),
        pytest.param({"carriers": ("b", "z")}, [0, 1, 0, 0], id="by id, unknown ones passed over"),
        pytest.param({"transponders": ("K2",)}, [0, 0, 1, 1], id="by transponder"),
        pytest.param({"carriers": ("a",), "transponders": ("K2",)}, [1, 0, 1, 1], id="both"),
        pytest.param({"carriers": ()}, [0, 0, 0, 0], id="none"),
    ],
)
@pytest.mark.parametrize("kind", ["sun_outage", "carrier_work"])
def test_carriers_are_masked_while_an_operation_lasts(kind, named, masked):
    inside = reported(kind, 2 * HOUR + MINUTE, 2 * HOUR + 2 * MINUTE, **named)
    np.testing.assert_array_equal(inside.is_masked, np.array(masked, dtype=bool))
    # start inclusive, stop exclusive
    assert reported(kind, HOUR, 2 * HOUR, **named).is_masked.tolist() == [bool(one) for one in masked]
    assert not reported(kind, 2 * HOUR + MINUTE, 3 * HOUR, **named).is_masked.any()


def test_work_on_carriers_frees_their_references_at_both_ends():
    for from_us, to_us, steps in (
        (HOUR, 2 * HOUR, 1),
        (2 * HOUR, 3 * HOUR - S, 0),
        (2 * HOUR, 3 * HOUR, 1),
        (HOUR, 4 * HOUR, 2),
    ):
        declared = reported("carrier_work", from_us, to_us, carriers=("c",))
        np.testing.assert_allclose(declared.reference_step_db, [0, 0, 3.0 * np.sqrt(steps), 0], atol=EXACT)


def test_a_change_of_gain_moves_the_carriers_of_a_transponder_together_at_both_ends():
    begun = reported("gain_change", HOUR, 2 * HOUR, transponders=("K1",))
    np.testing.assert_allclose(begun.group_step_db, [2.0, 0.0], atol=EXACT)
    np.testing.assert_array_equal(begun.reference_step_db, 0.0)
    np.testing.assert_array_equal(reported("gain_change", 2 * HOUR, 2 * HOUR + MINUTE).group_step_db, 0.0)
    np.testing.assert_allclose(reported("gain_change", 2 * HOUR, 3 * HOUR).group_step_db, 2.0, atol=EXACT)


def test_work_on_the_receiving_chain_lets_the_common_level_walk_and_step():
    begun = reported("receive_chain_work", HOUR, 2 * HOUR)
    assert begun.chain_step_db == pytest.approx(2.0, abs=EXACT)
    assert begun.chain_walk_db == 0.0
    during = reported("receive_chain_work", 2 * HOUR, 2 * HOUR + 30 * MINUTE)
    assert during.chain_walk_db == pytest.approx(2.0, abs=EXACT)
    assert during.chain_step_db == 0.0
    assert not during.is_masked.any()


def test_operations_add():
    both = (operation("gain_change"), operation("receive_chain_work"), operation("carrier_work", carriers=("a",)))
    declared = declared_between((*both, *both), NAMES, HOUR, 2 * HOUR, CONFIG)
    np.testing.assert_allclose(declared.group_step_db, 2.0 * np.sqrt(2.0), atol=EXACT)
    assert declared.chain_step_db == pytest.approx(2.0 * np.sqrt(2.0), abs=EXACT)
    assert declared.reference_step_db[0] == pytest.approx(3.0 * np.sqrt(2.0), abs=EXACT)
    assert declared.is_masked.tolist() == [True, False, False, False]


def test_another_source_is_a_step_of_the_chain():
    alone = with_chain_step(None, NAMES, 2.0)
    assert alone.chain_step_db == 2.0
    assert not any(np.any(value) for name, value in alone._asdict().items() if name != "chain_step_db")
    worked = reported("receive_chain_work", HOUR, 2 * HOUR)
    assert with_chain_step(worked, NAMES, 1.5).chain_step_db == pytest.approx(2.5, abs=EXACT)


def test_names_know_how_many_they_are():
    assert (NAMES.carriers, NAMES.transponders) == (4, 2)
