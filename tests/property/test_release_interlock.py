"""No sequence of events yields a released torque while a reason stands; nothing goes out twice; illegal is inert.

The driver judges every step by rules of its own (`tests/fakes/drivers/release_driver.py`), not by the interlock's.
"""

import pickle
from dataclasses import replace

from example_counts import examples
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule
from release_driver import DOUBT, GOOD, INPUTS, SETTINGS, US, ReleaseDriver

from service.core.control.sign_check import SignState
from service.core.control.slew_schedule import Envelope
from service.pipeline.control.release.command_states import TRANSITIONS, CommandState, CommandTransition, State
from service.pipeline.control.release.events import (
    Automatic,
    Cancel,
    Confirm,
    Engage,
    InputsChanged,
    JournalEffect,
    OrderKind,
    Report,
    ResponseJudged,
    RowSeen,
    SignJudged,
)
from service.records.levels.attitude import Axes, ReportedCommand
from service.records.operations.release import Purpose

PERSONS = st.sampled_from(["ann", "bob", "cas"])
NAN = float("nan")
BAD_ROWS = st.sampled_from(
    [
        {"inhibitions": ("sigma_roll",)},
        {"is_yaw_allowed": False},
        {"is_fading": True},
        {"redundancy": 1},
        {"inhibitions": ("chain_step",)},
        {"is_innovation_in_band": False},
        {"attitude_deg": Axes(0.0, 2.1, 0.0)},
        {"attitude_deg": Axes(0.0, 0.45, 0.0)},
        {"attitude_deg": Axes(NAN, NAN, NAN)},
        {"is_fading": True, "inhibitions": ("downlink_fade",)},
        {"is_fading": True, "inhibitions": ("downlink_fade", "operation"), "balance_axes": (False, False, False)},
    ]
)
CHANGES = st.sampled_from(
    [
        {"has_inhibiting_operation": True},
        {"momentum_share": 0.9},
        {"lease_holders": 2},
        {"calibration_id": 8},
        {"is_aligned": False},
        {"ephemeris_stop_us": 0},
        {"is_disagreeing": True},
        {"spacecraft_version": 2},
    ]
)
SLEWS = st.sampled_from(
    [
        {"roll_deg": 0.02},
        {"roll_deg": -0.05, "pitch_deg": 0.05},
        {"roll_deg": 0.0, "yaw_deg": 0.05},
        {"roll_deg": 0.099, "horizon_s": 1200.0},
        {"roll_deg": 0.3, "horizon_s": 3600.0},
        {"roll_deg": 0.1, "horizon_s": 300.0},
        {"roll_deg": 2.0, "horizon_s": 7200.0},
        {"roll_deg": 0.02, "purpose": Purpose.BALANCE},
        {"roll_deg": 0.3, "purpose": Purpose.BALANCE},
    ]
)


class AnyOrder(RuleBasedStateMachine):
    """Every event in any order; the driver asserts the laws in each step."""

    @initialize(start=st.sampled_from(["armed", "engaged", "nothing"]))
    def begin(self, start):
        self.driver = ReleaseDriver()
        self.past = []
        if start != "nothing":
            getattr(self.driver, start)()

    def send(self, event):
        self.past.append(event)
        return self.driver.send(event)

    @rule(count=st.integers(1, 12))
    def good_rows(self, count):
        self.driver.rows(count)

    @rule(change=BAD_ROWS)
    def bad_row(self, change):
        self.driver.rows(1, replace(GOOD, **change))

    @rule(seconds=st.sampled_from([0.0, 30.0, 200.0, 300.0, 4000.0, 50_000.0]))
    def time_passes(self, seconds):
        self.driver.tick(seconds)

    @rule(seconds=st.sampled_from([-1.0, -0.5, 0.5, 1.0, -600.0, -3.0, 3.0, 600.0]))
    def clock_jumps(self, seconds):
        self.driver.jump_clock(seconds)
        self.driver.tick()

    @rule(change=CHANGES)
    def something_changes(self, change):
        self.send(InputsChanged(self.driver.at, replace(self.driver.inputs, **change)))

    @rule()
    def all_is_well(self):
        self.send(
            InputsChanged(self.driver.at, replace(INPUTS, spacecraft_version=self.driver.inputs.spacecraft_version))
        )

    @rule(by=PERSONS, kind=st.sampled_from([OrderKind.ARM] * 6 + list(OrderKind)))
    def order(self, by, kind):
        self.driver.order(kind, by)

    @rule(
        by=PERSONS, hours=st.sampled_from([-1.0, 1.0, 1.0, 11.0, 30.0]), is_approver=st.booleans(), wide=st.booleans()
    )
    def engage(self, by, hours, is_approver, wide):
        until_us = self.driver.now_us // (3600 * US) * 3600 * US + round(hours * 3600 * US)
        envelope = Envelope(angle_change_deg=0.5) if wide else Envelope()
        self.send(Engage(self.driver.at, by, until_us, envelope, is_approver))

    @rule(
        axis=st.sampled_from(["yaw", "roll", "pitch"]), verdict=st.sampled_from([SignState.PLUS] * 6 + list(SignState))
    )
    def sign(self, axis, verdict):
        self.send(SignJudged(self.driver.at, axis, verdict))

    @rule(log_ratio=st.sampled_from([1.0, 2.0, -3.0, 8.9, 9.5]))
    def response(self, log_ratio):
        self.send(ResponseJudged(self.driver.at, log_ratio))

    @rule(by=PERSONS, wanted=SLEWS)
    def prepare(self, by, wanted):
        self.driver.prepare(by, **wanted)

    @precondition(lambda self: self.driver.state.commands)
    @rule(by=PERSONS, is_right=st.sampled_from([True, True, False]), is_approver=st.sampled_from([True, True, False]))
    def confirm(self, by, is_right, is_approver):
        command = self.driver.state.commands[-1]
        digest = command.digest if is_right else "0" * 64
        self.send(Confirm(self.driver.at, by, command.counter, digest, is_approver))

    @rule(wanted=SLEWS)
    def automatic(self, wanted):
        event = Automatic(self.driver.at, self.driver.proposal(**wanted))
        self.send(event)

    @rule(counter=st.integers(0, 9), turn=st.sampled_from(list(CommandTransition)))
    def report(self, counter, turn):
        self.send(Report(self.driver.at, counter, turn))

    @rule(counter=st.integers(0, 9))
    def cancel(self, counter):
        self.send(Cancel(self.driver.at, "ann", counter))

    @precondition(lambda self: self.past)
    @rule(data=st.data())
    def replayed(self, data):
        event = data.draw(st.sampled_from(self.past))
        self.driver.send(replace(event, at=self.driver.at))

    @rule(
        wanted=SLEWS, row=BAD_ROWS, change=CHANGES, kind=st.sampled_from(["row", "change", "jump", "stop", "silence"])
    )
    def something_stands_in_the_way_of_a_release(self, wanted, row, change, kind):
        self.driver.prepare("ann")
        if kind == "row":
            self.driver.rows(1, replace(GOOD, **row))
        elif kind == "change":
            self.something_changes(change)
        elif kind == "jump":
            self.driver.jump_clock(5.0)
        elif kind == "stop":
            self.driver.order(OrderKind.STOP)
        else:
            self.driver.pass_time(215.0)
        if self.driver.state.commands:
            self.driver.confirm("bob")
        self.automatic(wanted)

    @rule(hours=st.integers(1, 11))
    def everything_is_put_right(self, hours):
        """Come back to ENGAGED from wherever, so that most stories have something to lose."""
        driver = self.driver
        for command in driver.state.commands:
            driver.send(Report(driver.at, command.counter, CommandTransition.EXECUTED))
            driver.send(Cancel(driver.at, "ann", command.counter))
        self.all_is_well()
        driver.order(OrderKind.RESET)
        driver.rows(12)
        driver.order(OrderKind.ARM)
        for axis in ("roll", "pitch"):
            driver.send(SignJudged(driver.at, axis, SignState.PLUS))
        for person in ("ann", "bob"):
            driver.engage(person, until_us=driver.now_us + hours * 3600 * US)

    @rule(wanted=SLEWS, count=st.integers(1, 12))
    def the_law_goes_on(self, wanted, count):
        """Minute by minute; small requests, and at last any."""
        if self.driver.name != "ENGAGED":
            self.everything_is_put_right(6)
        for _ in range(count):
            self.driver.rows(1)
            self.driver.automatic(roll_deg=0.03)
        self.automatic(wanted)

    @rule(
        wanted=SLEWS,
        ending=st.sampled_from([CommandTransition.EXECUTED, CommandTransition.FAILED, CommandTransition.SENT]),
        by=PERSONS,
    )
    def persons_send_one(self, wanted, ending, by):
        if self.driver.name not in ("ARMED", "ENGAGED", "RECOVERY"):
            self.everything_is_put_right(6)
        self.driver.prepare("ann", **wanted)
        if self.driver.state.commands:
            self.confirm(by, True, True)
            self.report(self.driver.state.commands[-1].counter, ending)

    @rule()
    def killed(self):
        self.driver.state = pickle.loads(pickle.dumps(self.driver.state))  # noqa: S301 - our own bytes
        self.driver.restart()

    def teardown(self):
        """Hold what must be true of the whole story."""
        state = getattr(self, "driver", ReleaseDriver()).state
        assert sum(each.state in (CommandState.RELEASED, CommandState.SENT) for each in state.commands) <= 1
        assert len({each.counter for each in state.commands}) == len(state.commands)


AnyOrder.TestCase.settings = settings(
    max_examples=examples(60), stateful_step_count=40, deadline=None, suppress_health_check=list(HealthCheck)
)
test_any_order = AnyOrder.TestCase


def test_the_law_goes_on_after_the_clock_was_set_forth_and_back():
    """A sequence that `test_any_order` found: the wall clock shows 180 s where 780 steady seconds have passed."""
    story = AnyOrder()
    story.begin(start="armed")
    story.the_law_goes_on(wanted={"roll_deg": 0.02}, count=1)
    for seconds in (3.0, 600.0, 0.5, -600.0):
        story.clock_jumps(seconds)
    story.the_law_goes_on(wanted={"roll_deg": 0.02}, count=1)
    assert len(story.driver.released) > 1
    story.teardown()


def test_every_row_of_the_table_is_taken():
    """The laws would hold of a machine that never moves; each transition of the table really happens."""
    taken = set()
    for story in STORIES:
        driver = ReleaseDriver()
        before = driver.state.interlock.state
        for act in story:
            act(driver)
            after = driver.state.interlock.state
            if after is not before:
                taken.add((before, after))
            before = after
    wanted = {(row.source, row.target) for row in TRANSITIONS if row.source is not row.target}
    assert wanted - taken == set()


def _rows(count, **change):
    return lambda driver: driver.rows(count, replace(GOOD, **change))


def _order(kind):
    return lambda driver: driver.order(kind)


def _report(driver):
    driver.send(InputsChanged(driver.at, INPUTS))


BEYOND = {"attitude_deg": Axes(0.0, 0.45, 0.0)}
NOT_KNOWN = {"balance_axes": (False, False, False)}
_beyond, _beyond_long, _good = _rows(1, **BEYOND), _rows(12, **BEYOND), _rows(12)
_fade = _rows(1, is_fading=True, **NOT_KNOWN)
_doubt, _doubt_beyond = _rows(1, is_fading=True), _rows(1, is_fading=True, **BEYOND)
ARMED, ENGAGED = ReleaseDriver.armed, ReleaseDriver.engaged
STOP, RESET = _order(OrderKind.STOP), _order(OrderKind.RESET)
ARM, DISENGAGE = _order(OrderKind.ARM), _order(OrderKind.DISENGAGE)


def _ask(by):
    return lambda driver: driver.engage(by)


STORIES = [
    [STOP, RESET, _report, _good, ARM, STOP],
    [ARMED, _fade, _good, DISENGAGE],
    [ARMED, _ask("ann"), _ask("bob"), _fade, _good, DISENGAGE],
    [ENGAGED, _beyond, _good],
    [ENGAGED, STOP],
    [ENGAGED, lambda driver: [driver.rows(1) for _ in range(360)]],
    [ARMED, _beyond, _fade, _beyond_long, STOP],
    [ARMED, _beyond, DISENGAGE, _beyond_long, ARM],
    [ARMED, _ask("ann"), _ask("bob"), _beyond],
    [ARMED, _doubt, _good, _doubt, _fade, _good, _doubt, DISENGAGE],
    [ENGAGED, _doubt, _good, _doubt, STOP],
    [ARMED, _beyond, _doubt_beyond, _beyond_long],
]


def test_while_feedback_is_inhibited_only_the_known_torque_is_balanced():
    driver = ReleaseDriver().engaged()
    driver.rows(1, DOUBT)
    assert driver.name == "BALANCE"
    assert driver.automatic().refusal.code == "interlock.inhibited"
    assert driver.automatic(purpose=Purpose.BALANCE).refusal is None
    # the authorisation of two persons ends, and with it what goes by itself; two persons may release each command
    driver.rows(6 * 60, DOUBT)
    assert driver.name == "BALANCE"
    assert driver.automatic(purpose=Purpose.BALANCE).refusal.code == "interlock.not_engaged"
    driver.prepare("ann", purpose=Purpose.BALANCE)
    driver.confirm("bob")
    assert [command.purpose for _, _, command in driver.released] == [Purpose.BALANCE, Purpose.BALANCE]


def test_balance_ends_when_the_estimator_does_not_know_the_torque_any_more_and_does_not_come_back():
    driver = ReleaseDriver().engaged()
    driver.rows(1, DOUBT)
    driver.rows(1, replace(DOUBT, **NOT_KNOWN))
    assert driver.name == "INHIBITED"
    driver.rows(1, DOUBT)
    assert driver.name == "INHIBITED"
    assert driver.automatic(purpose=Purpose.BALANCE).refusal.code == "interlock.inhibited"


def test_states_of_the_table_are_all_states():
    assert {row.source for row in TRANSITIONS} == set(State)


def test_a_forged_jump_never_gives_more_than_the_envelope():
    driver = ReleaseDriver().engaged()
    driver.rows(1, replace(GOOD, attitude_deg=Axes(0.0, 2.5, 0.0)))
    assert driver.name == "INHIBITED"
    assert "hand_over" in driver.alarms
    # what the law would ask for is refused while inhibited, and a smaller forgery, within all limits, trips
    assert driver.automatic(roll_deg=-2.0, horizon_s=7200.0).refusal is not None
    driver = ReleaseDriver().engaged()
    driver.rows(1, replace(GOOD, attitude_deg=Axes(0.0, 0.39, 0.0)))
    assert driver.automatic(roll_deg=-0.39, horizon_s=3600.0).refusal is None
    assert driver.name == "TRIPPED"
    assert driver.released == []


def test_a_clock_ten_minutes_off_trips_and_releases_nothing():
    for seconds in (-600.0, 600.0):
        driver = ReleaseDriver().engaged()
        driver.automatic()
        assert len(driver.released) == 1
        driver.jump_clock(seconds)
        # the first thing after the jump is a row and the command that follows from it
        driver.send(RowSeen(driver.at, replace(GOOD, epoch_us=driver.now_us)))
        assert driver.automatic().refusal.code == "interlock.tripped"
        assert driver.name == "TRIPPED"
        assert driver.state.interlock.trips[0].word == "clock_jump"
        driver.rows(60)
        assert driver.automatic().refusal.code == "interlock.tripped"
        assert len(driver.released) == 1


def test_good_minutes_pass_by_the_steady_clock():
    """Steps of the wall clock, each too small to trip, must not bring the tenth good minute forward or put it off."""
    for step_s in (1.5, -1.5):
        driver = ReleaseDriver()
        driver.send(InputsChanged(driver.at, INPUTS))
        driver.rows(1)
        for _ in range(59):
            driver.jump_clock(step_s)
            driver.pass_time(10.0)
            driver.send(RowSeen(driver.at, replace(GOOD, epoch_us=driver.now_us)))
        driver.order(OrderKind.ARM)
        assert driver.name == "INHIBITED"
        driver.tick(10.0)
        driver.order(OrderKind.ARM)
        assert driver.name == "ARMED"


def test_killed_between_release_and_report_nothing_goes_out_again_and_the_report_still_counts():
    driver = ReleaseDriver().armed()
    driver.prepare()
    driver.confirm()
    driver.state = pickle.loads(pickle.dumps(driver.state))  # noqa: S301 - our own bytes
    driver.restart()
    assert driver.name == "INHIBITED"
    assert driver.confirm().refusal.code == "command.state"
    driver.rows(12)
    assert driver.name == "ARMED"
    assert driver.prepare().refusal.code == "command.unreported"
    driver.rows(25)
    assert driver.name == "INHIBITED"
    assert driver.alarms.count("report_late") == 1
    step = driver.send(Report(driver.at, 1, CommandTransition.EXECUTED))
    assert step.effects[0] == JournalEffect(ReportedCommand(1, driver.now_us, driver.command(1).schedule))
    assert [counter for counter, _, _ in driver.released] == [1]
    driver.rows(11)
    assert driver.name == "ARMED"


def test_replayed_commands_go_out_once():
    driver = ReleaseDriver().engaged()
    first = Automatic(driver.at, driver.proposal())
    driver.send(first)
    for _ in range(5):
        driver.rows(1)
        assert driver.send(replace(first, at=driver.at)).refusal.code == "command.duplicate"
    driver.send(Report(driver.at, 1, CommandTransition.EXECUTED))
    driver.prepare("ann")
    command = driver.state.commands[-1]
    confirmation = Confirm(driver.at, "bob", command.counter, command.digest, is_approver=True)
    assert driver.send(confirmation).refusal is None
    assert driver.send(confirmation).refusal.code == "command.state"
    assert len(driver.released) == 2
    assert SETTINGS.max_unreported == 1
