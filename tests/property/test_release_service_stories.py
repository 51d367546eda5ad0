"""No story of rows, persons, faults and kills makes the service release while a reason stands, or send anything twice.

`tests/fakes/drivers/release_service_driver.py` judges each release by rules of its own. A killed service starts
again with what was stored.
"""

import pytest
from example_counts import examples
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule
from release_service_driver import US, ReleaseServiceDriver
from release_storage import SC

from service.errors import SooError
from service.pipeline.control.release.events import OrderKind
from service.pipeline.estimation.method import CommandEvidence
from service.records.inputs import Operation
from service.records.levels.attitude import Axes

NAN = float("nan")
PERSONS = st.sampled_from(["ann", "bob", "cas"])
BAD_ROWS = st.sampled_from(
    [
        {"inhibitions": ("sigma_roll",), "control_allowed": False},
        {"downlink_fade": True},
        {"carriers_used": 4},
        {"inhibitions": ("chain_step",), "control_allowed": False},
        {"attitude_deg": Axes(0.0, 2.1, 0.0), "inhibitions": ("beyond_validity",)},
        {
            "attitude_deg": Axes(0.0, 2.6, 0.1),
            "protection_deg": Axes(1.0, 0.8, 0.7),
            "inhibitions": ("beyond_validity", "protection_level"),
        },
        {"attitude_deg": Axes(0.0, 0.45, 0.0), "inhibitions": ("beyond_validity",)},
        {"attitude_deg": Axes(NAN, NAN, NAN)},
    ]
)
FACTS = st.sampled_from(
    [
        {"is_aligned": False},
        {"calibration_id": 8},
        {"ephemeris_stop_us": 0},
        {"operations": [Operation(1, "other", 0, None, inhibit_control=True)]},
    ]
)


class AnyStory(RuleBasedStateMachine):
    """A service, its persons and its faults; a refusal is an error of the service, anything else ends the story."""

    @initialize(start=st.sampled_from(["armed", "engaged", "nothing"]))
    def begin(self, start):
        self.driver = ReleaseServiceDriver()
        if start != "nothing":
            getattr(self.driver, start)()

    def tried(self, act, *arguments, **named):
        try:
            return act(*arguments, **named)
        except SooError:
            return None
        finally:
            self.driver.judge()

    @rule(count=st.integers(1, 14))
    def good_rows(self, count):
        self.driver.rows(count)

    @rule(change=BAD_ROWS)
    def bad_row(self, change):
        self.driver.rows(1, **change)

    @rule(ratio=st.sampled_from([1.0, 8.9, 9.5, NAN]))
    def response(self, ratio):
        self.driver.rows(1, evidence=CommandEvidence(None, None, ratio, None))

    @rule(seconds=st.sampled_from([1.0, 30.0, 220.0, 4000.0, 50_000.0]))
    def time_passes(self, seconds):
        self.driver.pass_time(seconds)
        self.driver.note()
        self.driver.service.tick()

    @rule(seconds=st.sampled_from([-600.0, -3.0, 1.0, 3.0, 600.0]))
    def the_clock_jumps(self, seconds):
        # not noted: a clock that is set and set back before the service reads it blocks nothing
        self.driver.clock.now += round(seconds * US)

    @rule(facts=FACTS)
    def facts_change_and_come_back(self, facts):
        former = {name: getattr(self.driver.archive, name) for name in facts}
        self.driver.tell(**facts)
        self.tried(self.driver.sent)
        self.driver.tell(**former)

    @rule(n_m_s=st.sampled_from([1.0, 17.0]))
    def momentum_is_told(self, n_m_s):
        self.driver.momentum(n_m_s)
        self.driver.note()

    @rule(kind=st.sampled_from(list(OrderKind)), by=PERSONS)
    def order(self, kind, by):
        self.tried(self.driver.order, kind, by)

    @rule(by=PERSONS, is_approver=st.booleans(), hours=st.sampled_from([1.0, 6.0, 13.0]))
    def engage(self, by, is_approver, hours):
        self.tried(self.driver.engage, by, hours, is_approver=is_approver)

    @rule(by=PERSONS, duration_s=st.sampled_from([None, 600.0, 5.0]))
    def prepare(self, by, duration_s):
        self.tried(self.driver.prepare, by, duration_s=duration_s)

    @precondition(lambda self: self.driver.releases.views)
    @rule(by=PERSONS, is_right=st.sampled_from([True, True, False]), is_approver=st.sampled_from([True, True, False]))
    def confirm(self, by, is_right, is_approver):
        command = self.driver.releases.views[max(self.driver.releases.views)]
        digest = "" if is_right else "0" * 64
        self.tried(self.driver.confirm, command, by, is_approver=is_approver, digest=digest)

    @rule(counter=st.integers(0, 9), turn=st.sampled_from(["sent", "executed", "failed"]))
    def report(self, counter, turn):
        self.tried(self.driver.report, counter, turn)

    @rule(counter=st.integers(0, 9))
    def cancel(self, counter):
        self.tried(self.driver.service.cancel, SC, counter, "ann")

    @rule(by=PERSONS, moment=st.sampled_from(["before", "after"]))
    def killed_while_it_stores(self, by, moment):
        command = self.tried(self.driver.prepare, "ann")
        if command is not None:
            self.driver.killed_at(moment, lambda: self.tried(self.driver.confirm, command, by))

    @rule()
    def killed(self):
        self.driver.restart()

    @rule()
    def the_archive_is_away_for_a_while(self):
        self.driver.releases.is_away = True
        self.tried(self.driver.order, OrderKind.ARM)
        self.tried(self.driver.sent)
        self.driver.rows(2)
        self.driver.releases.is_away = False

    @rule()
    def everything_is_put_right(self):
        """Come back to ENGAGED from wherever, so that most stories have something to lose."""
        driver = self.driver
        driver.archive.telemetry.clear()
        for counter in list(driver.releases.views):
            self.tried(driver.report, counter)
            self.tried(driver.service.cancel, SC, counter, "ann")
        driver.tell(calibration_id=7, operations=[], is_aligned=True)
        driver.rows(12)
        self.tried(driver.order, OrderKind.RESET)
        driver.rows(12)
        self.tried(driver.order, OrderKind.ARM)
        driver.prove("roll", "pitch")
        for person in ("ann", "bob"):
            self.tried(driver.engage, person)

    @rule(count=st.integers(1, 5))
    def the_law_goes_on(self, count):
        for _ in range(count):
            self.driver.rows(16)
            for counter in self.driver.view.unreported_commands:
                self.tried(self.driver.report, counter)


AnyStory.TestCase.settings = settings(
    max_examples=examples(25), stateful_step_count=25, deadline=None, suppress_health_check=list(HealthCheck)
)
test_any_story = AnyStory.TestCase


def _engaged_and_sending():
    driver = ReleaseServiceDriver().engaged()
    driver.rows(1)
    assert len(driver.releases.released) == 1
    driver.report(1)
    return driver


@pytest.mark.parametrize("seconds", [-600.0, 600.0])
def test_after_a_jump_of_the_clock_nothing_goes(seconds):
    driver = _engaged_and_sending()
    driver.clock.now += round(seconds * US)
    for _ in range(40):
        driver.rows(1)
    assert driver.view.trips == ("clock_jump",)
    assert len(driver.releases.released) == 1
    driver.restart()
    driver.rows(40)
    assert (driver.state, len(driver.releases.released)) == ("TRIPPED", 1)


def test_killed_between_release_and_report_it_goes_on_and_the_report_still_counts():
    driver = ReleaseServiceDriver().engaged()
    driver.rows(1)
    driver.restart()
    driver.rows(15)
    assert (driver.state, driver.view.unreported_commands) == ("ENGAGED", (1,))
    assert len(driver.releases.released) == 1
    driver.report(1)
    driver.rows(1)
    assert len(driver.releases.released) == 2
