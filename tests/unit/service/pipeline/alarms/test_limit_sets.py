"""Limit sets: declared operations and rain choose them, later ones prevail, what is stated is checked."""

import pytest

from service.pipeline.alarms.conditions import condition_table
from service.pipeline.alarms.limit_sets import (
    DEFAULT_SETS,
    SETS,
    AlarmContext,
    context,
    faults_of,
    limits_in_force,
)
from service.pipeline.config import AlarmConfig, RobustConfig
from service.records.catalogue import Carrier, CarrierPlan
from service.records.inputs import Operation
from service.records.operations.alarm_limits import AlarmLimits

CONDITIONS = condition_table(AlarmConfig(), RobustConfig())
PLAN = CarrierPlan(1, "sha", tuple(Carrier(f"c{k}", "Ku", f"t{k // 2}", 11e9, 1e6) for k in range(4)))


def at(epoch_us, *operations, is_raining=False):
    return context(operations, PLAN, epoch_us, is_raining=is_raining)


def test_nothing_declared_is_the_normal_set():
    assert at(5) == AlarmContext()


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("station_keeping", "manoeuvre"),
        ("momentum_unloading", "manoeuvre"),
        ("calibration_turn", "manoeuvre"),
        ("eclipse", "eclipse"),
    ],
)
def test_a_set_is_in_force_from_the_start_of_its_operation_to_its_end(kind, name):
    operation = Operation(1, kind, 10, 20)
    assert [name in at(epoch_us, operation).sets for epoch_us in (9, 10, 19, 20)] == [False, True, True, False]
    assert (at(9, operation).until_us, at(15, operation)[2:], at(25, operation).since_us) == (10, (10, 20), 20)


def test_an_operation_without_an_end_goes_on():
    assert at(1 << 50, Operation(1, "eclipse", 10, None)).sets == ("normal", "eclipse")


def test_sets_in_force_together_stand_in_their_order():
    both = (Operation(1, "station_keeping", 0, 9), Operation(2, "eclipse", 0, 9))
    assert at(5, *both, is_raining=True).sets == SETS


@pytest.mark.parametrize("kind", ["carrier_work", "sun_outage", "gain_change", "receive_chain_work"])
def test_work_keeps_quiet_what_it_names(kind):
    named = Operation(1, kind, 0, 9, carriers=("c0",), transponders=("t1",))
    assert at(5, named).quiet_carriers == {"c0", "c2", "c3"}
    assert at(5, Operation(1, kind, 0, 9)).quiet_carriers == set(PLAN.carrier_ids)
    assert at(9, named).quiet_carriers == frozenset()
    holds = at(5, named)
    assert holds.is_quiet("carrier_absent", "c0")
    assert not holds.is_quiet("carrier_absent", "c1")
    assert not holds.is_quiet("attitude_angle", "c0")


def test_a_manoeuvre_widens_the_angles_and_quietens_what_it_disturbs():
    limits = limits_in_force(CONDITIONS, AlarmLimits(), ("normal", "manoeuvre"))
    assert (limits["attitude_angle"].warning, limits["attitude_angle"].critical) == (0.5, 0.8)
    assert limits["methods_disagree"].suppressed
    assert limits["carrier_absent"] == CONDITIONS["carrier_absent"].limits


def test_what_is_stated_prevails_over_the_default_of_its_set_and_under_that_of_a_later_one():
    stated = AlarmLimits(1, sets={"normal": {"carrier_level": {"warning": 1.0, "deadband": 0.1}}})
    normal = limits_in_force(CONDITIONS, stated, ("normal",))["carrier_level"]
    rain = limits_in_force(CONDITIONS, stated, ("normal", "rain"))["carrier_level"]
    assert (normal.warning, normal.distress, normal.deadband) == (1.0, 6.0, 0.1)
    assert (rain.warning, rain.distress, rain.deadband) == (8.0, 15.0, 0.1)


def test_the_sets_by_default_are_in_order():
    assert set(DEFAULT_SETS) == set(SETS)
    assert faults_of(CONDITIONS, AlarmLimits(sets={name: dict(each) for name, each in DEFAULT_SETS.items()})) == ()


def test_faults_name_the_condition_and_what_is_wrong():
    sets = {
        "normal": {"carrier_level": {"warning": 7.0}, "carrier_c_n0": {"distress": 8.0}, "nonsense": {}},
        "rain": {"carrier_level": {"warning": 20.0}},
        "eclipse": {"carrier_absent": {"warning": None}},
    }
    faults = faults_of(CONDITIONS, AlarmLimits(sets=sets))
    assert [(fault.pointer, fault.code) for fault in faults] == [
        ("/sets/normal/carrier_level", "alarm_limits.order"),
        ("/sets/normal/carrier_c_n0", "alarm_limits.order"),
        ("/sets/normal/nonsense", "alarm_limits.condition"),
        ("/sets/rain/carrier_level", "alarm_limits.order"),
    ]
