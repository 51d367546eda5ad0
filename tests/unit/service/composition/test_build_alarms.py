"""Settings decide who is told of alarms, and the limits that hold by default."""

import pytest

from service.composition.bootstrap import build_alarms
from service.composition.settings import Settings
from service.runtime.clock import SystemClock
from service.runtime.live.live_feed import LiveFeed

MAIL = {"alarm_mail_host": "mail.test", "alarm_mail_to": "a@x.test, b@x.test,"}
HOOK = {"alarm_webhook_url": "http://hook.test/"}


@pytest.mark.parametrize(
    ("given", "names"),
    [
        ({}, []),
        (HOOK, ["webhook"]),
        (MAIL, ["mail"]),
        ({**HOOK, **MAIL}, ["webhook", "mail"]),
        ({"alarm_mail_host": "mail.test"}, []),
    ],
)
def test_channels_are_those_of_the_settings(given, names):
    desk = build_alarms(Settings.model_validate(given), None, SystemClock(), LiveFeed(), lambda: 1)
    assert [channel.name for channel in desk.notices.channels] == names


def test_limits_by_default_come_from_the_settings():
    given = {"alarms": {"attitude_warning_deg": 0.25}, "robust": {"disagreement_deg": 0.2}}
    desk = build_alarms(Settings.model_validate(given), None, SystemClock(), LiveFeed(), lambda: 1)
    assert desk.conditions["attitude_angle"].limits.warning == 0.25
    assert desk.conditions["methods_disagree"].limits.warning == 0.2
