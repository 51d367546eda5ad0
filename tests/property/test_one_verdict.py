"""After every event of the interlock all answers carry the same verdict, and it never allows too much.

The answers are those of the routes, the stream, the metrics and the demonstration, over an archive in memory; what is
allowed is judged by the rules of `tests/fakes/drivers/release_service_driver.py`, not by the interlock's.
"""

from contextlib import suppress
from io import StringIO
from types import SimpleNamespace

import pytest
from example_counts import examples
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from release_service_driver import GOOD, US, ReleaseServiceDriver
from release_storage import SC
from rich.console import Console

from service.api.context.dependencies import Limits
from service.api.monitoring.metrics import Metrics
from service.api.routes.attitude import get_attitude
from service.api.routes.control import get_control
from service.api.routes.torques import get_torques
from service.api.views.handover import handover_of
from service.api.views.status import status_of
from service.cli.demonstration.operation_screen import operation_screen
from service.errors import SooError
from service.pipeline.config import InterlockConfig, TorqueConfig
from service.pipeline.control.command.compute_command import NO_CARRY, compute_command
from service.pipeline.control.release.events import OrderKind
from service.records.catalogue import ControlMode, Method, Release
from service.records.epoch import format_epoch
from service.records.inputs import Operation
from service.records.levels.attitude import Axes, Status

NAN = float("nan")
BAD_ROWS = st.sampled_from(
    [
        {"sigma_deg": Axes(0.08, 0.07, 0.03), "inhibitions": ("sigma_roll",), "control_allowed": False},
        {"downlink_fade": True, "inhibitions": ("downlink_fade",), "control_allowed": False},
        {"inhibitions": ("chain_step",), "control_allowed": False},
        {"attitude_deg": Axes(0.0, 0.35, 0.0), "inhibitions": ("beyond_validity",), "control_allowed": False},
        {"attitude_deg": Axes(0.0, 0.45, 0.0), "inhibitions": ("beyond_validity",), "control_allowed": False},
        {"rates_deg_s": None},
        {"status": Status.INVALID, "attitude_deg": Axes(NAN, NAN, NAN), "inhibitions": ("no_fix",)},
        {"status": Status.EXPIRED, "inhibitions": ("no_ephemeris",), "control_allowed": False},
    ]
)


class Client:
    """Client of the demonstration whose answers are the routes' own."""

    service_url = "http://soo.test"

    def __init__(self, context):
        self._context = context

    def attitude(self, spacecraft_id, method=Method.ROBUST):
        return get_attitude(spacecraft_id, Method(method), self._context).model_dump(mode="json")

    def status(self, spacecraft_id):
        return status_of(self._context, spacecraft_id).model_dump(mode="json")

    def control(self, spacecraft_id):
        return get_control(spacecraft_id, self._context).model_dump(mode="json")

    def torques(self, spacecraft_id):
        return get_torques(spacecraft_id, self._context).model_dump(mode="json")


def context_of(driver):
    """Return what routes are handed, over the driver's archive."""

    def newest_row(_spacecraft_id, _version, method):
        return driver.row if method is Method.ROBUST else None

    def newest_command(*_):
        if driver.row is None:
            return None
        return compute_command(driver.row, driver.archive.record, NO_CARRY, 60.0, TorqueConfig()).command

    archive = driver.archive
    head = SimpleNamespace(consumed_epoch_us=None, newest_epoch_us=None, newest_number=0, consumed_number=0)
    alignment = SimpleNamespace(id=1, epoch_us=GOOD.epoch_us, calibration_by_method={}, references_by_method={})
    results = vars(archive.results) | {
        "newest_attitude": newest_row,
        "newest_command": newest_command,
        "pending": lambda *_: 0,
        "alignments": lambda _: (alignment,) if archive.is_aligned else (),
        "calibrations": lambda *_: (),
    }
    storage = SimpleNamespace(
        releases=archive.releases,
        catalogue=SimpleNamespace(
            spacecraft=archive.catalogue.spacecraft,
            all_spacecraft=archive.catalogue.all_spacecraft,
            ephemeris=lambda _: SimpleNamespace(id=1, valid_start_us=0, valid_stop_us=archive.ephemeris_stop_us),
        ),
        archive=SimpleNamespace(head=lambda _: head, sources=lambda _: (), inputs=lambda *_: ()),
        results=SimpleNamespace(**results),
        alarms=SimpleNamespace(open_alarms=lambda _: ()),
        links=SimpleNamespace(links=lambda *_: ()),
        keys=SimpleNamespace(all=lambda: ()),
        notes=SimpleNamespace(newest=lambda *_: ()),
        state=lambda: SimpleNamespace(queued_writes=0, free_bytes=None),
    )
    return SimpleNamespace(
        storage=storage,
        clock=driver.clock,
        release_service=driver.service,
        limits=Limits(),
        interlock=InterlockConfig(),
        supervisor=SimpleNamespace(
            is_disagreeing=lambda _: False, carrier_states=lambda _: None, is_catching_up=lambda _: False
        ),
        alarms=SimpleNamespace(notices=SimpleNamespace(channels=())),
    )


def answers(driver):
    """Return the verdict of every answer about the present, by name."""
    context = context_of(driver)
    control, handover = get_control(SC, context), handover_of(context, SC)
    reported = {
        "attitude": get_attitude(SC, Method.ROBUST, context).control,
        "attitude of the other method": get_attitude(SC, Method.PAPER, context).control,
        "status": status_of(context, SC).control,
        "control": control.control,
        "torques": get_torques(SC, context).control,
        "hand-over": handover.control,
        "status in the hand-over": handover.status.control,
    }
    assert (control.state, control.reasons) == (control.control.state, [one.code for one in control.control.reasons])
    judge_conditions(control)
    return {name: verdict.model_dump(include={"allowed", "state", "reasons"}) for name, verdict in reported.items()}


def judge_conditions(control):
    """Hold the conditions of an answer against its verdict, and each value against its limit."""
    conditions = {each.code: each for each in control.conditions}
    assert len(conditions) == len(control.conditions)
    unmet = {code for code, each in conditions.items() if each.met is False}
    assert unmet == {reason.code for reason in control.control.reasons}
    withholding = [each for each in control.conditions if each.consequence != "yaw"]
    assert all(each.met for each in withholding) == control.control.allowed
    since = {reason.code: reason.since for reason in control.control.reasons}
    for code, each in conditions.items():
        assert each.since == since.get(code)
        assert each.bound is not None or (each.value is None and each.limit is None)
        if each.value is not None and each.limit is not None:
            is_beyond = each.value < each.limit if each.bound == "least" else each.value > each.limit
            assert not (is_beyond and each.met) or code == "good_minutes", each
    good, condition = control.good_minutes, conditions["good_minutes"]
    assert (condition.value, condition.limit) == (good.elapsed_s, good.needed_s)
    assert (good.since is None) <= (good.elapsed_s == 0.0)
    assert 0.0 <= good.elapsed_s <= good.needed_s
    if control.armed and control.control.allowed:
        assert good.elapsed_s == good.needed_s


class AnyStory(RuleBasedStateMachine):
    """A service, its persons and its faults."""

    @initialize(release=st.sampled_from(Release), start=st.sampled_from(["armed", "engaged", "nothing"]))
    def begin(self, release, start):
        self.driver = ReleaseServiceDriver()
        self.is_automatic = release is Release.AUTOMATIC
        self.reset_us = None
        if self.is_automatic:
            self.driver.archive.change_spacecraft(release=release)
            self.driver.rows(2)
        elif start != "nothing":
            getattr(self.driver, start)()

    @rule(count=st.integers(1, 12))
    def good_rows(self, count):
        self.driver.rows(count)

    @rule(sigma_deg=st.sampled_from([GOOD.sigma_deg, GOOD.sigma_deg._replace(yaw=0.3)]), is_yaw_allowed=st.booleans())
    def row_that_knows_little_of_yaw(self, sigma_deg, is_yaw_allowed):
        self.driver.rows(1, sigma_deg=sigma_deg, control_allowed_axes=(is_yaw_allowed, True, True))

    @rule(change=BAD_ROWS)
    def bad_row(self, change):
        self.driver.rows(1, **change)

    @rule(seconds=st.sampled_from([1.0, 100.0, 250.0, 4000.0]))
    def time_passes(self, seconds):
        self.driver.pass_time(seconds)
        self.driver.note()
        self.driver.service.tick()

    @rule(kind=st.sampled_from([OrderKind.STOP, OrderKind.RESET, OrderKind.RESET, OrderKind.ARM, OrderKind.DISENGAGE]))
    def order(self, kind):
        with suppress(SooError):
            self.driver.order(kind)
            if kind is OrderKind.RESET:
                self.reset_us = self.driver.clock.now

    @rule(n_m_s=st.sampled_from([1.0, 17.0]))
    def momentum(self, n_m_s):
        self.driver.momentum(n_m_s)

    @rule(
        facts=st.sampled_from(
            [
                {"is_aligned": False},
                {"operations": [Operation(1, "other", 0, None, inhibit_control=True)]},
                {"ephemeris_stop_us": 0},
                {"is_aligned": True, "operations": [], "ephemeris_stop_us": GOOD.epoch_us + 90 * 86_400 * US},
            ]
        )
    )
    def facts_change(self, facts):
        self.driver.tell(**facts)

    @rule(mode=st.sampled_from(ControlMode))
    def the_mode_changes(self, mode):
        self.driver.archive.change_spacecraft(mode=mode)
        self.driver.tell()

    @rule()
    def killed(self):
        self.driver.restart()

    @rule()
    def the_archive_is_away_for_a_while(self):
        self.driver.releases.is_away = True
        self.driver.rows(1)
        self.all_answers_agree()
        self.driver.releases.is_away = False

    @invariant()
    def all_answers_agree(self):
        driver = self.driver
        reported = answers(driver)
        (verdict, *others) = reported.values()
        assert all(other == verdict for other in others), reported
        context = context_of(driver)
        metrics = SimpleNamespace(_context=context)
        samples = {name: value for name, _, value in Metrics._attitude(metrics, driver.archive.record)}
        assert samples["soo_control_allowed"] == verdict["allowed"]
        self._judge(verdict)
        if driver.row is not None:
            self._judge_demonstration(context, verdict)
            if verdict["state"] == "TRIPPED":
                assert get_torques(SC, context).schedule == []

    def _judge(self, verdict):
        """Hold the verdict against the facts alone."""
        driver = self.driver
        if verdict["allowed"]:
            assert verdict["state"] in ("ARMED", "ENGAGED", "RECOVERY")
            assert not driver.is_bad()
            assert not driver.row.inhibitions
            assert driver.archive.record.control.mode is ControlMode.GROUND
            assert self.reset_us is None or driver.clock.now - self.reset_us >= 600 * US
            assert {one["code"] for one in verdict["reasons"]} <= {"sigma_yaw", "yaw_sign", "yaw_beyond"}
            # a computed command has a yaw torque unless its row withholds it, and a released one is checked
            assert not self.is_automatic or bool(verdict["reasons"]) != driver.row.control_allowed_axes[0]
        else:
            assert verdict["reasons"]
        for reason in verdict["reasons"]:
            assert reason["text"]
            assert reason["next_step"]
            assert reason["since"] is None or reason["since"] <= format_epoch(driver.clock.now)

    def _judge_demonstration(self, context, verdict):
        began = {"operation": (format_epoch(0), format_epoch(0))}
        story = SimpleNamespace(spacecraft_id=SC, truth_deg={}, phases=began, centre=None)
        scene = SimpleNamespace(client=Client(context), story=story, phase="operation")
        written = StringIO()
        Console(width=2000, file=written).print(operation_screen(scene, None, {}))
        first = written.getvalue().splitlines()[0]
        assert ("no torque: " in first) != verdict["allowed"]


AnyStory.TestCase.settings = settings(
    max_examples=examples(25), stateful_step_count=20, deadline=None, suppress_health_check=list(HealthCheck)
)
test_any_story = AnyStory.TestCase


@pytest.mark.parametrize("release", Release)
def test_a_stop_is_told_by_every_answer(release):
    driver = ReleaseServiceDriver()
    driver.archive.change_spacecraft(release=release)
    driver.rows(12)
    if release is Release.TWO_STEP:
        driver.order(OrderKind.ARM)
    assert all(reported["allowed"] for reported in answers(driver).values())
    driver.order(OrderKind.STOP)
    for reported in answers(driver).values():
        assert (reported["allowed"], reported["state"], reported["reasons"][0]["code"]) == (False, "TRIPPED", "stop")
        assert reported["reasons"][0]["since"] == format_epoch(driver.clock.now)
