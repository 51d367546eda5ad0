"""The closed loop: controllers, store of a flight, knowledge of the ground, merit and releases."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from service.pipeline.chain import ChainRow
from service.pipeline.config import TorqueConfig
from service.pipeline.control.release.interlock_conditions import ReleaseSettings
from service.pipeline.estimation.method import CommandEvidence
from service.pipeline.inputs.knowledge import Knowledge
from service.ports.archive import Outcome
from service.records.catalogue import (
    AxisTorques,
    ControlMode,
    ControlSettings,
    Method,
    Onboard,
    Release,
    Site,
    Spacecraft,
)
from service.records.inputs import PlanChange
from service.records.levels.attitude import (
    AppliedCommand,
    Axes,
    Pulse,
    ReleasedCommand,
    ReportedCommand,
    Status,
    TorqueCommand,
    row_without_attitude,
)
from service.records.levels.measurement import Measurement
from service.study.closed_loop.campaign import (
    COLUMNS,
    LoopCampaign,
    LoopPlan,
    as_document,
    cells,
    keep,
    kept,
    markdown,
    verdict,
)
from service.study.closed_loop.centre import Centre
from service.study.closed_loop.controllers import LEAD_S, ByTruth, Controller, Sensing, postponed
from service.study.closed_loop.figures import draw_campaign
from service.study.closed_loop.ground_knowledge import AXIS_RELATIVE_ERROR, RELATIVE_ERROR, ground_of
from service.study.closed_loop.plant_process import CommandReport, PlantProcess, SpacecraftTruth
from service.study.closed_loop.run import (
    COMMAND_PERIOD_S,
    LOOP_PERIOD_S,
    MEASURED_SCENARIO,
    NARROW_DEG,
    UNKNOWN_TORQUE_SCENARIOS,
    WIDE_DEG,
    FlownRun,
    LoopResult,
    LoopUnit,
    flown_spacecraft,
    group_merit,
    run_merit,
)

S = 1_000_000
ZERO = Axes(0.0, 0.0, 0.0)
RELEASE_LEAD_S, PERIOD_S, ROW_S = 150.0, 600.0, 60.0
CRAFT = Spacecraft(
    "yamal-202",
    "",
    90.0,
    Site(55.0, 37.0),
    ((2600.0, 0.0, 0.0), (0.0, 1400.0, 0.0), (0.0, 0.0, 2600.0)),
    0.05,
    simulated=True,
    onboard=Onboard(fast_loop=True, forecast_mode=True),
    control=ControlSettings(release=Release.TWO_STEP, command_period_s=PERIOD_S),
)


class RecordedChain:
    """Stands for the chain: gives the rows that are laid before it and remembers its inputs."""

    def __init__(self, spacecraft=CRAFT):
        plan, ephemeris = SimpleNamespace(id=1), SimpleNamespace(valid_stop_us=30 * 86_400 * S)
        self.knowledge = Knowledge(spacecraft, plan, ephemeris, alignment=SimpleNamespace(id=1))
        self.announced, self.outcome, self.evidence = [], None, None

    def rows(self, measurements):
        return [ChainRow(each, self.outcome, command_evidence=lambda: self.evidence) for each in measurements]

    def update(self, content):
        self.announced.append(content)
        if isinstance(content, PlanChange):
            self.knowledge = self.knowledge._replace(plan=SimpleNamespace(id=content.plan_id))


class Link:
    """A centre, row by row."""

    def __init__(self, spacecraft=CRAFT):
        self.chain = RecordedChain(spacecraft)
        self.centre = Centre(self.chain, ReleaseSettings(), TorqueConfig())
        self.rows = 0

    def row(self, roll_deg=0.1, **changes):
        """Return the product that goes out after the next row."""
        self.rows += 1
        epoch_us = round(self.rows * ROW_S * S)
        plain = row_without_attitude(epoch_us, epoch_us, self.rows, Method.ROBUST, ())
        good = {
            "status": Status.ACQUIRED,
            "control_allowed": True,
            "control_allowed_axes": (True, True, True),
            "carriers_used": 12,
        }
        row = replace(plain, attitude_deg=Axes(0.0, roll_deg, 0.0), rates_deg_s=ZERO, **{**good, **changes})
        self.chain.outcome = Outcome((row,), None)
        measurement = Measurement(epoch_us, epoch_us, self.rows, "sa-1", 1, np.zeros(0), None, feeds_estimator=True)
        return self.centre.decide(measurement, SpacecraftTruth(epoch_us, ZERO, ZERO, 0.0)).product

    def until_sent(self, **changes):
        """Return the next product, and after how many rows it went out."""
        before = self.rows
        for _ in range(60):
            product = self.row(**changes)
            if product is not None:
                return product, self.rows - before
        raise AssertionError("nothing went out within an hour")

    def report(self, counter, state, until_us=None):
        self.centre.on_input([CommandReport(counter, state, ZERO, until_us or 0, until_us)])

    def entries(self, kind):
        return [content for content in self.chain.announced if isinstance(content, kind)]


@pytest.fixture
def link():
    return Link()


def stop_us(schedule):
    return max(pulse.start_us + round(pulse.duration_s * S) for pulse in schedule)


def test_two_persons_take_control_up_and_a_command_waits_for_its_report(link):
    product, rows = link.until_sent()
    # ten good minutes, and a row for the law to be asked
    assert rows == 12
    assert min(pulse.start_us for pulse in product.schedule) == round((link.rows * ROW_S + RELEASE_LEAD_S) * S)
    assert link.entries(ReleasedCommand) == [ReleasedCommand(1, round(link.rows * ROW_S * S), product.schedule)]
    while link.rows * ROW_S * S < stop_us(product.schedule):
        assert link.row() is None
    link.report(1, "executed", stop_us(product.schedule))
    (executed,) = link.entries(ReportedCommand)
    assert (executed.counter, executed.executed) == (1, product.schedule)
    again, _ = link.until_sent()
    assert again.counter == 2
    assert link.centre.trips == ()


@pytest.mark.parametrize("state", ["late", "refused", "replaced"])
def test_what_the_craft_does_not_execute_is_reported_as_nothing(link, state):
    link.until_sent()
    link.report(1, state)
    link.report(1, state)
    assert [entry.executed for entry in link.entries(ReportedCommand)] == [()]
    assert link.until_sent()[0].counter == 2


def test_what_is_lost_is_given_up_and_a_repetition_says_nothing(link):
    product, _ = link.until_sent()
    link.report(1, "repeated")
    while not link.entries(ReportedCommand):
        assert link.row() is None
    over_us = stop_us(product.schedule) + 60 * S
    assert over_us <= link.rows * ROW_S * S < over_us + round(ROW_S * S)
    assert link.entries(ReportedCommand)[0].executed == ()


def test_after_an_inhibition_nothing_goes_out_for_ten_good_minutes(link):
    product, _ = link.until_sent()
    link.row(inhibitions=("downlink_fade",), control_allowed=False)
    link.report(1, "executed", stop_us(product.schedule))
    assert link.until_sent()[1] == 11


def test_a_person_leads_back_from_beyond_the_range_of_automatic_control(link):
    beyond = {
        "roll_deg": 0.6,
        "inhibitions": ("beyond_validity",),
        "control_allowed": False,
        "control_allowed_axes": (False, False, False),
    }
    product, _ = link.until_sent(**beyond)
    roll = [pulse for pulse in product.schedule if pulse.torque_n_m.roll]
    assert roll[0].torque_n_m.roll < 0.0
    assert not any(pulse.torque_n_m.yaw for pulse in product.schedule)


def test_the_ground_s_own_change_of_the_plan_trips_and_is_taken_up_again(link):
    link.until_sent()
    link.centre.on_ground(PlanChange(2))
    link.row()
    link.report(1, "refused")
    assert link.centre.trips == ("configuration",)
    assert link.until_sent()[1] >= 10


def test_a_missed_response_trips_for_good(link):
    link.until_sent()
    link.chain.evidence = CommandEvidence(None, np.zeros(0), 20.0, None)
    link.row()
    link.chain.evidence = None
    link.report(1, "refused")
    assert [link.row() for _ in range(30)] == [None] * 30
    assert link.centre.trips == ("response_missed",)


NOTHING = Axes(0.0, 0.0, 0.0)
MEASUREMENT = Measurement(0, 0, 1, "sa-1", 1, np.zeros(0), None, feeds_estimator=True)
AUTOMATIC = replace(CRAFT, control=ControlSettings(release=Release.AUTOMATIC))


def truth(roll_deg):
    return SpacecraftTruth(0, Axes(0.0, roll_deg, 0.0), NOTHING, 0.0)


def command():
    announced = ByTruth(AUTOMATIC, 0.0, 60.0)
    decision = announced.decide(MEASUREMENT, truth(0.5))
    assert decision.schedule
    return TorqueCommand(
        *(0, 1, 0, "ground", NOTHING, (0.0,) * 3, False, 60.0, 60_000_000, decision.schedule),
        *(NOTHING, NOTHING, NOTHING, (0.0,) * 3, True, ()),
    )


def test_the_chain_hears_the_mean_torque_of_what_a_loop_on_board_has_done():
    onboard = replace(CRAFT, control=replace(CRAFT.control, mode=ControlMode.ONBOARD))
    link = Link(onboard)
    assert link.row().attitude_deg.roll == 0.1
    link.chain.outcome = replace(link.chain.outcome, command=command())
    impulse = Axes(0.0, 0.012, -0.006)
    executed = CommandReport(4, "executed", impulse, 120_000_000, 66_000_000, 60_000_000)
    link.centre.decide(MEASUREMENT, truth(0.0))
    link.centre.on_input((executed, CommandReport(5, "refused", NOTHING), replace_state(executed, "repeated")))
    (applied,) = link.entries(AppliedCommand)
    (pulse,) = applied.command.schedule
    assert (pulse.start_us, pulse.duration_s) == (60_000_000, 6.0)
    assert pulse.torque_n_m == pytest.approx((0.0, 0.002, -0.001))


def replace_state(report, state):
    return report._replace(state=state)


def test_nobody_sends_nothing():
    assert Controller().decide(MEASUREMENT, truth(1.0)).schedule == ()


@pytest.mark.parametrize("roll_deg", [0.5, -0.5])
def test_perfect_sensing_pushes_against_the_angle(roll_deg):
    (pulse,) = [
        p for p in ByTruth(AUTOMATIC, LEAD_S, 60.0).decide(MEASUREMENT, truth(roll_deg)).schedule if p.torque_n_m.roll
    ]
    assert pulse.torque_n_m.roll * roll_deg < 0.0
    assert pulse.start_us == round(LEAD_S * 1e6)


def test_what_perfect_sensing_cannot_express_is_carried_on():
    controller = ByTruth(AUTOMATIC, 0.0, 60.0)
    given = [controller.decide(MEASUREMENT, truth(0.001)).schedule for k in range(200)]
    assert 0 < sum(map(bool, given)) < 200


def test_a_postponed_command_is_the_same_later():
    plain = command()
    later = postponed(plain, 90.0)
    assert later.schedule == tuple(Pulse(p.start_us + 90_000_000, p.duration_s, p.torque_n_m) for p in plain.schedule)
    assert replace(later, schedule=plain.schedule) == plain


def test_perfect_sensing_sees_roll_and_yaw_exchange():
    turned = truth(0.0)._replace(attitude_deg=Axes(1.0, 0.0, 0.0))
    given = [p for p in ByTruth(AUTOMATIC, 0.0, 60.0).decide(MEASUREMENT, turned).schedule if p.torque_n_m.roll]
    # yaw of 1 deg turns roll by 0.26 deg/h, which the law holds up
    assert given
    assert given[0].torque_n_m.roll < 0.0


def test_over_an_ideal_uplink_a_command_counts_from_its_epoch():
    link = Link(AUTOMATIC)
    link.chain.outcome = Outcome((), command(), AppliedCommand(command()))
    decision = link.centre.decide(MEASUREMENT, truth(0.0))
    assert decision.schedule == command().schedule
    assert link.entries(AppliedCommand) == [AppliedCommand(command())]
    link.chain.outcome = Outcome((), replace(command(), control_allowed=False, schedule=()))
    assert link.centre.decide(MEASUREMENT, truth(0.0)).is_inhibited
    link.chain.outcome = None
    assert link.centre.decide(MEASUREMENT, truth(0.0)).is_inhibited


UNIT = LoopUnit("nominal", 3, Sensing.AUTOMATIC, "link", 0.5, 1e-6)


def flight():
    rng = np.random.default_rng(1)
    flags = rng.uniform(size=5) < 0.5
    truth_deg, estimate_deg = rng.normal(size=(5, 3)), np.full((5, 3), np.nan)
    counts = {"late": 1}, {"fade": 2}
    return FlownRun(np.arange(5.0), truth_deg, estimate_deg, flags, ~flags, (0.1, 0.2, 0.3), 7, *counts, ("envelope",))


def test_a_flight_comes_back_as_it_was_kept(tmp_path):
    result = LoopResult(UNIT, 12.5, "", flight())
    keep(tmp_path / "new", result)
    again = kept(tmp_path / "new", UNIT)
    assert (again.unit, again.seconds, again.refusal) == (UNIT, 12.5, "")
    for name in ("hours", "truth_deg", "estimate_deg", "is_inhibited", "is_faded"):
        np.testing.assert_array_equal(getattr(again.flight, name), getattr(result.flight, name))
    assert (again.flight.impulse_n_m_s, again.flight.sent, again.flight.reported) == ((0.1, 0.2, 0.3), 7, {"late": 1})
    assert (again.flight.reasons, again.flight.trips) == ({"fade": 2}, ("envelope",))
    assert not list((tmp_path / "new").glob("*.half"))


@pytest.mark.parametrize("changes", [{"operation_days": 1.0}, {"uplink": "ideal"}, {"residual_torque_n_m": 6.3e-7}])
def test_a_unit_of_another_setting_is_not_there(tmp_path, changes):
    keep(tmp_path, LoopResult(UNIT, 1.0, "no calibration"))
    assert kept(tmp_path, UNIT._replace(**changes)) is None
    assert kept(tmp_path, UNIT._replace(seed=4)) is None
    assert kept(tmp_path, UNIT) == LoopResult(UNIT, 1.0, "no calibration")


def test_the_ground_states_what_the_plant_announces_and_how_wrong_it_may_be():
    with PlantProcess("nominal", 1, operation_days=0.01) as plant:
        opening = plant.opening()
    stated = ground_of(opening).spacecraft.onboard.fed_forward_torque
    announced = opening.fed_forward
    assert stated.cosine_n_m == AxisTorques(**announced["cosine_n_m"])
    assert stated.sine_n_m == AxisTorques(**announced["sine_n_m"])
    # of the order of the light of the Sun, 95 % of it
    assert 1.2e-5 < (stated.cosine_n_m.roll**2 + stated.sine_n_m.roll**2) ** 0.5 < 1.3e-5
    assert (stated.relative_error, stated.axis_relative_error) == (RELATIVE_ERROR, AXIS_RELATIVE_ERROR)
    assert ground_of(opening).spacecraft.onboard.residual_torque_n_m == 0.0
    flown = flown_spacecraft(ground_of(opening).spacecraft, Release.TWO_STEP).control
    assert (flown.period_s, flown.command_period_s) == (LOOP_PERIOD_S, COMMAND_PERIOD_S)
    silent = replace(opening, fed_forward=None)
    assert ground_of(silent).spacecraft.onboard.fed_forward_torque is None


@pytest.mark.parametrize("name", ["unknown_residual_constant", "unknown_residual_daily"])
def test_of_a_torque_that_nobody_knows_the_catalogue_has_its_defaults(name):
    with PlantProcess(name, 1, operation_days=0.01) as plant:
        record = ground_of(plant.opening()).spacecraft
    assert (record.onboard.residual_torque_n_m, record.onboard.fed_forward_torque) == (None, None)
    for release in Release:
        control = flown_spacecraft(record, release).control
        assert control == replace(ControlSettings(), release=release, method=record.control.method)


ROWS = 600


def settled_flight(largest_deg=(0.1, 0.1, 0.1), faded_rows=(0, 0), settles_at=0, inhibited=0):
    """Return ten hours at a row a minute; roll and pitch sit at their largest until a row, then at nothing."""
    truth = np.zeros((ROWS, 3))
    truth[0] = largest_deg
    truth[:settles_at, 1:] = largest_deg[1:]
    wet = np.zeros(ROWS, dtype=np.bool_)
    wet[slice(*faded_rows)] = True
    return FlownRun(
        hours=np.arange(ROWS) / 60.0,
        truth_deg=truth,
        estimate_deg=truth,
        is_inhibited=np.arange(ROWS) < inhibited,
        is_faded=wet,
        impulse_n_m_s=(0.01, 0.02, 0.03),
        sent=3,
        reported={"executed": 3},
        reasons={},
    )


def results(flights, scenario="nominal", sensing=Sensing.AUTOMATIC):
    return [
        LoopResult(LoopUnit(scenario, seed, sensing), 1.0, "" if flown else "refused", flown)
        for seed, flown in enumerate(flights, start=1)
    ]


def test_figures_of_a_run_are_those_of_its_rows():
    merit = run_merit(settled_flight((0.3, -0.15, 0.1), inhibited=90))
    assert merit.largest_deg == (0.3, 0.15, 0.1)
    assert merit.inhibited_h == pytest.approx(1.5)
    assert merit.impulse_n_m_s == (0.01, 0.02, 0.03)
    assert merit.settled_h is None


@pytest.mark.parametrize(
    ("largest_deg", "is_narrow", "is_wide"),
    [
        ((0.39, 0.19, 0.19), True, True),
        ((0.41, 0.1, 0.1), False, True),
        ((0.1, 0.21, 0.1), False, True),
        ((0.1, 0.1, 0.31), False, False),
        ((0.51, 0.1, 0.1), False, False),
    ],
)
def test_limits_are_those_that_were_asked(largest_deg, is_narrow, is_wide):
    merit = run_merit(settled_flight(largest_deg))
    assert (merit.is_within(NARROW_DEG), merit.is_within(WIDE_DEG)) == (is_narrow, is_wide)


def test_the_time_to_come_back_counts_from_the_end_of_the_fade():
    # wet until row 99, small again from row 160 on
    merit = run_merit(settled_flight((0.0, 0.35, 0.35), (20, 100), 160))
    assert merit.settled_h == pytest.approx(61 / 60)
    assert merit.is_fade_survived
    assert not run_merit(settled_flight((0.0, 0.41, 0.0), (20, 100), 160)).is_fade_survived
    assert not run_merit(settled_flight((0.0, 0.35, 0.0), (20, 100), 290)).is_fade_survived
    never = run_merit(settled_flight((0.0, 0.35, 0.0), (20, 100), ROWS))
    assert never.settled_h == math.inf


def test_an_unknown_torque_is_survived_within_its_limits_and_without_losing_control():
    for name in UNKNOWN_TORQUE_SCENARIOS:
        kept = group_merit(results([settled_flight((0.99, 0.29, 0.29), inhibited=15)], name))
        assert kept.is_met
        assert kept.longest_inhibited_h == pytest.approx(0.25)
        for bad in (settled_flight((1.01, 0.1, 0.1)), settled_flight((0.1, 0.1, 0.31)), settled_flight(inhibited=16)):
            assert not group_merit(results([settled_flight(), bad], name)).is_met
    assert group_merit(results([settled_flight(inhibited=16)])).is_met  # of any other story rows may be inhibited


def test_the_longest_inhibition_is_one_without_a_break():
    broken = replace(settled_flight(), is_inhibited=np.arange(ROWS) % 20 < 12)
    merit = run_merit(broken)
    assert merit.longest_inhibited_h == pytest.approx(0.2)
    assert merit.inhibited_h == pytest.approx(6.0)
    assert run_merit(settled_flight()).longest_inhibited_h == 0.0


def test_a_group_is_met_by_95_percent_within_the_narrow_and_all_within_the_wide_limits():
    good, odd, bad = settled_flight(), settled_flight((0.45, 0.1, 0.1)), settled_flight((0.1, 0.5, 0.1))
    assert group_merit(results([good] * 19 + [odd])).is_met
    assert not group_merit(results([good] * 18 + [odd] * 2)).is_met
    assert not group_merit(results([good] * 19 + [bad])).is_met
    # a run that was refused is not kept
    refused = group_merit(results([good] * 9 + [None]))
    assert (refused.refused, refused.narrow_share, refused.is_met) == (1, 0.9, False)


def test_percentiles_are_runs_that_were_flown():
    announced = group_merit(results([settled_flight((size, 0.0, 0.0)) for size in (0.1, 0.2, 0.4)]))
    assert [triple[0] for triple in announced.largest_deg] == [0.2, 0.4, 0.4]


def test_a_group_without_any_flight_is_missed():
    announced = group_merit(results([None]))
    assert not announced.is_met
    assert math.isnan(announced.largest_deg[0][0])


def test_no_control_that_does_not_fail_is_a_finding():
    calm = group_merit(results([settled_flight()], sensing=Sensing.OFF))
    wild = group_merit(results([settled_flight((3.0, 2.0, 1.0))], sensing=Sensing.OFF))
    assert (verdict(calm), verdict(wild)) == ("does not fail", "fails as it must")
    plan = LoopPlan(("nominal",), 1)
    assert LoopCampaign(plan, 1.0, (), (calm,)).missed == (calm,)
    assert LoopCampaign(plan, 1.0, (), (wild,)).missed == ()


def test_table_document_and_figure_hold_every_group(tmp_path):
    announced = [*results([settled_flight()]), *results([None], sensing=Sensing.TRUTH)]
    groups = tuple(group_merit([result]) for result in announced)
    campaign = LoopCampaign(LoopPlan(("nominal",), 1), 1.0, tuple(announced), groups)
    assert all(len(cells(group)) == len(COLUMNS) for group in groups)
    assert markdown(campaign).count("\n") == 4
    document = json.loads(json.dumps(as_document(campaign, "command"), allow_nan=False))
    assert [run["refusal"] for run in document["runs"]] == ["", "refused"]
    assert document["groups"][1]["largest_deg"][0] == [None] * 3
    drawn = draw_campaign(campaign, tmp_path)
    assert [path.stem for path in drawn] == [f"closed-loop-nominal{kind}" for kind in ("", "-run", "-percentiles")]
    assert all(path.stat().st_size > 10_000 for path in drawn)


def test_yaw_by_reported_wheels_is_held_in_19_of_20_runs():
    good, odd = settled_flight((0.25, 0.1, 0.1)), settled_flight((0.26, 0.1, 0.1))
    assert group_merit(results([good] * 19 + [odd], MEASURED_SCENARIO)).is_met
    assert not group_merit(results([good] * 18 + [odd] * 2, MEASURED_SCENARIO)).is_met
    assert not group_merit(results([good] * 18 + [settled_flight((0.1, 0.21, 0.1))] * 2, MEASURED_SCENARIO)).is_met
