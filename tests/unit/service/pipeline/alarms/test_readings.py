"""From rows to readings: what each condition looks at, and which rows never alarm."""

import math
from dataclasses import replace

import numpy as np
import pytest

from service.pipeline.alarms.alarm_engine import AlarmEngine
from service.pipeline.alarms.conditions import condition_table
from service.pipeline.alarms.readings import RowReader
from service.pipeline.config import AlarmConfig, RobustConfig
from service.pipeline.estimation.method import CarrierLevels, RowEvidence
from service.records.catalogue import Carrier, CarrierPlan, Method
from service.records.inputs import AttitudeReference, Operation
from service.records.levels.attitude import NO_ANGLES, Axes, Status, row_without_attitude
from service.records.levels.measurement import CarrierDetails, Measurement, QualityFlag
from service.records.operations.alarms import AlarmLimits, EngineMemory

S = 1_000_000
NAN = math.nan
CONDITIONS = condition_table(AlarmConfig(), RobustConfig())
PLAN = CarrierPlan(1, "sha", tuple(Carrier(f"c{k}", "Ku", "t", 11e9, 1e6) for k in range(3)))
IDS = PLAN.carrier_ids
#: every condition at once
AT_ONCE = {name: {"on_s": 0.0, "off_s": 0.0} for name in CONDITIONS} | {
    name: {"warning": 0.0, "off_s": 0.0} for name in ("carrier_absent", "attitude_lost", "measured_motion")
}


class Rig:
    """A reader over a book in which everything alarms at once, and rows of every minute."""

    def __init__(self, **changes):
        limits = AlarmLimits(1, sets={"normal": {**AT_ONCE, **changes}})
        self.engine = AlarmEngine("craft", CONDITIONS, limits)
        self.reader = RowReader(self.engine, EngineMemory())
        self.operations = {}

    def row(self, minute, *, power_dbm=(-40.0,) * 3, flags=None, c_n0_db_hz=None, is_late=False, **more):
        epoch_us = minute * 60 * S
        details = None
        if c_n0_db_hz is not None:
            blank = np.full(3, NAN)
            details = CarrierDetails(blank, np.array(c_n0_db_hz, dtype=np.float32), blank, blank)
        masks = None if flags is None else np.array(flags)
        powers = np.array(power_dbm)
        measurement = Measurement(epoch_us, epoch_us, minute, "sa", 1, powers, masks, is_late, details=details)
        facts = {"rows": (), "method": Method.ROBUST, "levels": None, **more}
        return self.reader.read_row(RowEvidence(measurement, PLAN, operations=self.operations, **facts))

    def alarms(self, *args, **more):
        return {(change.alarm.condition, change.alarm.thing) for change in self.row(*args, **more)}


def attitude(minute, method=Method.ROBUST, angles=(0.0, 0.0, 0.0), **changes):
    row = row_without_attitude(minute * 60 * S, 0, minute, method, ())
    changes = {"status": Status.ACQUIRED, "sigma_deg": Axes(0.01, 0.01, 0.01), **changes}
    return replace(row, attitude_deg=Axes(*angles), **changes)


def levels(deviation_db=(0.0,) * 3, residual_db=(0.0,) * 3):
    is_used, hypothesis = np.ones(len(IDS), dtype=bool), np.zeros(len(IDS), dtype=np.int64)
    sigma_db = np.full(len(IDS), 0.2)
    return CarrierLevels(IDS, np.array(deviation_db), np.array(residual_db), sigma_db, is_used, hypothesis)


def test_a_row_as_it_should_be_alarms_nothing():
    rig = Rig()
    assert rig.row(1, rows=(attitude(1), attitude(1, Method.PAPER)), levels=levels(), c_n0_db_hz=(80.0,) * 3) == []
    assert rig.engine.watches() == ()


@pytest.mark.parametrize(
    ("facts", "expected"),
    [
        ({"power_dbm": (-40.0, NAN, -40.0)}, {("carrier_absent", "c1")}),
        ({"levels": levels(deviation_db=(0.0, -3.5, NAN))}, {("carrier_level", "c1")}),
        ({"levels": levels(residual_db=(1.6, 0.0, 0.0))}, {("carrier_residual", "c0")}),
        ({"c_n0_db_hz": (65.5, NAN, 66.5)}, {("carrier_c_n0", "c0")}),
        ({"rows": (attitude(1, angles=(0.1, -0.31, 0.0)),)}, {("attitude_angle", "roll")}),
        ({"rows": (attitude(1, protection_deg=Axes(0.9, 0.1, 0.23)),)}, {("protection_level", "pitch")}),
        ({"rows": (attitude(1, angles=NO_ANGLES, status=Status.EXPIRED),)}, {("attitude_lost", "robust")}),
        ({"rows": (attitude(1, downlink_fade=True, downlink_fade_db=2.0),)}, {("downlink_fade", "receiving site")}),
        ({"rows": (attitude(1, downlink_fade=True, downlink_fade_db=NAN),)}, {("downlink_fade", "receiving site")}),
        (
            {"rows": (attitude(1), attitude(1, Method.PAPER)), "disagreement_deg": 0.16},
            {("methods_disagree", "robust, paper")},
        ),
    ],
)
def test_each_condition_looks_at_its_figures(facts, expected):
    assert Rig().alarms(1, **facts) == expected


def test_the_method_that_drives_control_is_looked_at():
    rows = (attitude(1, angles=(0.0, 0.35, 0.35)), attitude(1, Method.PAPER, angles=(0.0, 0.25, 0.31)))
    assert Rig().alarms(1, rows=rows, method=Method.PAPER) == {("attitude_angle", "pitch")}


def test_a_method_that_has_only_begun_is_not_lost():
    begun = attitude(1, angles=NO_ANGLES, status=Status.INVALID, inhibitions=("settling",))
    assert Rig().alarms(1, rows=(begun,)) == set()


def test_a_carrier_that_is_not_measured_is_not_absent():
    flags = (0, int(QualityFlag.NOT_MEASURED), int(QualityFlag.NO_CARRIER))
    assert Rig().alarms(1, power_dbm=(-40.0, NAN, NAN), flags=flags) == {("carrier_absent", "c2")}


def test_a_nominal_level_counts_where_nothing_better_is_expected():
    rig = Rig()
    rig.reader.use_nominal({"c0": -44.0, "c1": -44.0})
    assert rig.alarms(1) == {("carrier_level", "c0"), ("carrier_level", "c1")}
    rig = Rig()
    rig.reader.use_nominal({"c0": -44.0, "c1": -44.0})
    assert rig.alarms(1, levels=levels(deviation_db=(0.0, NAN, 5.0))) == {
        ("carrier_level", "c1"),
        ("carrier_level", "c2"),
    }


def test_late_rows_and_rows_out_of_order_never_alarm():
    absent = {"power_dbm": (NAN,) * 3}
    rig = Rig()
    assert rig.row(1, is_late=True, **absent) == []
    assert rig.row(5) == []
    assert rig.row(5, **absent) == []
    assert rig.row(4, **absent) == []
    assert rig.reader.newest_row_us == 300 * S
    assert len(rig.row(6, **absent)) == 3
    # nor do they end anything
    assert rig.row(7, is_late=True) == []


def test_a_reader_goes_on_where_it_stood():
    reader = RowReader(AlarmEngine("craft", CONDITIONS), EngineMemory((), 600 * S, 60.0))
    assert (reader.newest_row_us, reader.row_period_s) == (600 * S, 60.0)


def test_the_period_is_the_median_distance_of_rows():
    rig = Rig()
    assert rig.reader.row_period_s is None
    for minute in (1, 2, 3, 9, 10):
        rig.row(minute)
    assert rig.reader.row_period_s == 60.0


def test_a_declared_operation_suppresses_the_alarms_of_its_carriers_while_it_lasts():
    rig = Rig()
    rig.operations = {1: Operation(1, "carrier_work", 2 * 60 * S, 4 * 60 * S, carriers=("c0",))}
    reported = []
    for minute in range(1, 6):
        reported += [(minute, c.kind.value, c.is_told) for c in rig.row(minute, power_dbm=(NAN, -40.0, -40.0))]
    assert reported == [(1, "raised", True), (2, "suppressed", False), (4, "released", True)]


def reference(minute, roll=0.0, sigma=0.01, **changes):
    plain = AttitudeReference("earth_sensor", minute * 60 * S, Axes(NAN, roll, NAN), Axes(NAN, sigma, NAN))
    return replace(plain, **changes)


def test_a_sensor_that_differs_beyond_the_sigmas_of_both_disagrees():
    rig = Rig()
    rig.row(10, rows=(attitude(10),))
    assert rig.reader.read_reference(reference(10, roll=0.1)) == []
    assert rig.reader.read_reference(reference(10, roll=0.2, sigma=0.1)) == []
    (change,) = rig.reader.read_reference(reference(11, roll=0.2))
    assert (change.alarm.condition, change.alarm.thing) == ("sensor_disagreement", "earth_sensor")
    assert (change.alarm.value, change.alarm.unit) == (0.2, "deg")


@pytest.mark.parametrize(("protection_deg", "cause"), [(0.3, ("downlink_fade", "receiving site")), (0.1, None)])
def test_a_fade_explains_a_sensor_within_the_protection_level_of_its_axis_and_no_further(protection_deg, cause):
    rig = Rig(downlink_fade={"on_s": 0.0})
    bounds = {"protection_deg": Axes(1.0, protection_deg, 1.0)}
    rig.row(10, rows=(attitude(10, downlink_fade=True, downlink_fade_db=3.0, **bounds),))
    (change,) = rig.reader.read_reference(reference(11, roll=0.2))
    assert (change.alarm.cause, change.is_told) == (cause, cause is None)


def test_a_carrier_that_sank_into_the_noise_with_the_fade_follows_from_it_and_one_lost_before_does_not():
    rig = Rig()
    rig.row(1, rows=(attitude(1),), c_n0_db_hz=(68.0,) * 3)
    changes = rig.row(2, rows=(attitude(2),), power_dbm=(NAN, -40.0, -40.0), c_n0_db_hz=(NAN, 68.0, 68.0))
    assert [(change.alarm.thing, change.is_told) for change in changes] == [("c0", True)]
    wet = {"downlink_fade": True, "downlink_fade_db": 8.0}
    for minute in range(3, 9):
        answers = (attitude(minute, **wet),)
        rig.row(minute, rows=answers, power_dbm=(NAN, NAN, -48.0), c_n0_db_hz=(NAN, NAN, 60.2))
    carriers = {name: rig.engine.open_alarms["carrier_absent", name].cause for name in ("c0", "c1")}
    assert carriers == {"c0": None, "c1": ("downlink_fade", "receiving site")}


def test_references_far_from_the_newest_row_or_without_angles_say_nothing():
    rig = Rig()
    assert rig.reader.read_reference(reference(10, roll=1.0)) == []
    rig.row(10, rows=(attitude(10),))
    assert rig.reader.read_reference(reference(4, roll=1.0)) == []
    assert rig.reader.read_reference(reference(16, roll=1.0)) == []
    assert rig.reader.read_reference(reference(10, attitude_deg=NO_ANGLES)) == []


def test_thrusters_without_a_declared_operation_alarm_while_they_inhibit():
    rig = Rig()
    acting = (attitude(0, inhibitions=("undeclared_operation",)), attitude(1, inhibitions=("undeclared_operation",)))
    assert rig.alarms(-1, rows=(attitude(-1),)) == set()
    assert rig.alarms(0, rows=acting[:1]) | rig.alarms(1, rows=acting[1:]) == {("undeclared_operation", "thrusters")}
    ended = [change.kind.value for minute in (2, 3) for change in rig.row(minute, rows=(attitude(minute),))]
    assert ended == ["returned"]


def test_measured_motion_that_is_left_out_or_jumped_alarms_by_its_advice_and_other_advice_does_not():
    rig = Rig()
    advised = ("realign", "rates_in_loop", "momentum_jump", "polarimeter_moved")
    assert rig.alarms(0, rows=(attitude(0),)) == set()
    raised = rig.alarms(1, rows=(attitude(1, advice=advised),)) | rig.alarms(2, rows=(attitude(2, advice=advised),))
    assert raised == {("measured_motion", "momentum_jump"), ("measured_motion", "polarimeter_moved")}
    cleared = rig.alarms(3, rows=(attitude(3),)) | rig.alarms(4, rows=(attitude(4),))
    assert cleared == raised
