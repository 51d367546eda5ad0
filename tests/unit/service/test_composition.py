"""Settings: every one can be set from the environment and reaches its stage, alarms included."""

from dataclasses import fields, is_dataclass

import pytest
from pydantic import ValidationError

from service.composition.bootstrap import build_alarms
from service.composition.settings import Settings
from service.runtime.clock import SystemClock
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.supervisor import StepFailures

PLAIN = {
    "SOO_DATABASE_URL": ("database_url", "sqlite:///elsewhere.db", "sqlite:///elsewhere.db"),
    "SOO_DATABASE_TIMEOUT_S": ("database_timeout_s", "2.5", 2.5),
    "SOO_CLOCK": ("clock", "data", "data"),
    "SOO_HOST": ("host", "0.0.0.0", "0.0.0.0"),  # noqa: S104 - a value to read, nothing listens
    "SOO_PORT": ("port", "0", 0),
    "SOO_LOG_LEVEL": ("log_level", "debug", "debug"),
    "SOO_LOG_FORMAT": ("log_format", "text", "text"),
    "SOO_ACCESS_LOG": ("access_log", "false", False),
    "SOO_ESTIMATOR": ("estimator", "false", False),
    "SOO_PLAIN_SESSIONS": ("plain_sessions", "true", True),
    "SOO_METRICS_NEED_KEY": ("metrics_need_key", "true", True),
    "SOO_READY_LAG": ("ready_lag", "7", 7),
    "SOO_MIN_FREE_DISK_BYTES": ("min_free_disk_bytes", "1000", 1000),
    "SOO_MAX_STREAMS": ("max_streams", "3", 3),
    "SOO_MAX_CONNECTIONS": ("max_connections", "9", 9),
    "SOO_MAX_CONNECTIONS_PER_ADDRESS": ("max_connections_per_address", "5", 5),
    "SOO_MAX_SOURCES_PER_KEY": ("max_sources_per_key", "4", 4),
    "SOO_TLS_CERTIFICATE": ("tls_certificate", "chain.pem", "chain.pem"),
    "SOO_TLS_KEY": ("tls_key", "key.pem", "key.pem"),
    "SOO_TRUSTED_PROXIES": ("trusted_proxies", "10.0.0.0/8,::1", "10.0.0.0/8,::1"),
    "SOO_ALLOWED_ORIGINS": (
        "allowed_origins",
        "http://[::1]:3000, https://a.test",
        "http://[::1]:3000, https://a.test",
    ),
    "SOO_REQUEST_TIMEOUT_S": ("request_timeout_s", "5", 5.0),
    "SOO_FUTURE_TOLERANCE_S": ("future_tolerance_s", "7.5", 7.5),
    "SOO_FUTURE_TOLERANCE_DATA_S": ("future_tolerance_data_s", "60", 60.0),
    "SOO_LATE_AFTER_S": ("late_after_s", "120", 120.0),
    "SOO_MAX_BODY_BYTES": ("max_body_bytes", "2048", 2048),
    "SOO_MAX_ROWS_PER_BATCH": ("max_rows_per_batch", "5", 5),
    "SOO_EVIDENCE_TRACES": ("evidence_traces", "0", 0),
    "SOO_EVIDENCE_BYTES": ("evidence_bytes", "1000", 1000),
    "SOO_ALARM_NOTICES_FROM": ("alarm_notices_from", "critical", "critical"),
    "SOO_ALARM_MAIL_HOST": ("alarm_mail_host", "mail.test", "mail.test"),
    "SOO_ALARM_MAIL_PORT": ("alarm_mail_port", "25", 25),
    "SOO_ALARM_MAIL_SECURITY": ("alarm_mail_security", "tls", "tls"),
    "SOO_ALARM_MAIL_USER": ("alarm_mail_user", "anna", "anna"),
    "SOO_ALARM_MAIL_FROM": ("alarm_mail_from", "soo@ground.test", "soo@ground.test"),
    "SOO_ALARM_MAIL_TO": ("alarm_mail_to", "a@x.test,b@x.test", "a@x.test,b@x.test"),
}
SECRET = ("bootstrap_key", "alarm_webhook_url", "alarm_webhook_secret", "alarm_mail_password")


def leaves(value, path):
    """Yield (path, value) of every number of nested configurations."""
    for field in fields(value):
        found = getattr(value, field.name)
        if is_dataclass(found):
            yield from leaves(found, (*path, field.name))
        else:
            yield (*path, field.name), found


GROUPS = [name for name in Settings.model_fields if is_dataclass(getattr(Settings(), name))]
NESTED = [leaf for name in GROUPS for leaf in leaves(getattr(Settings(), name), (name,))]


def read(settings, path):
    for name in path:
        settings = getattr(settings, name)
    return settings


@pytest.mark.parametrize("variable", PLAIN)
def test_a_plain_setting_comes_from_its_variable(monkeypatch, variable):
    name, text, expected = PLAIN[variable]
    assert getattr(Settings(), name) != expected
    monkeypatch.setenv(variable, text)
    assert getattr(Settings(), name) == expected


@pytest.mark.parametrize("name", SECRET)
def test_a_secret_is_read_and_never_shown(monkeypatch, name):
    monkeypatch.setenv(f"SOO_{name.upper()}", "top-secret")
    settings = Settings()
    assert getattr(settings, name).get_secret_value() == "top-secret"
    assert "top-secret" not in repr(settings)


def test_an_empty_variable_counts_as_not_set(monkeypatch):
    for variable in ("SOO_BOOTSTRAP_KEY", "SOO_PORT", "SOO_CLOCK"):
        monkeypatch.setenv(variable, "")
    assert (Settings().bootstrap_key, Settings().port, Settings().clock) == (None, 8000, "system")


@pytest.mark.parametrize(
    ("path", "default"), NESTED, ids=lambda value: "__".join(value) if isinstance(value, tuple) else ""
)
def test_a_nested_setting_comes_from_its_variable_and_moves_nothing_else(monkeypatch, path, default):
    changed = default + type(default)(1)
    monkeypatch.setenv("SOO_" + "__".join(path).upper(), str(changed))
    settings = Settings()
    assert read(settings, path) == changed
    others = {other: read(settings, other) for other, _ in NESTED if other != path}
    assert others == {other: value for other, value in NESTED if other != path}


def test_every_setting_is_tried_here_and_says_what_it_is():
    tried = {name for name, _, _ in PLAIN.values()} | set(GROUPS) | set(SECRET)
    assert tried == set(Settings.model_fields)
    assert all(field.description for field in Settings.model_fields.values())


def test_the_chain_gets_the_settings_of_its_stages(monkeypatch):
    monkeypatch.setenv("SOO_INTERLOCK__VALIDITY_LIMIT_DEG", "0.35")
    monkeypatch.setenv("SOO_TORQUE__MIN_PULSE_S", "0.2")
    monkeypatch.setenv("SOO_FADE__DEPTH_DB", "0.4")
    monkeypatch.setenv("SOO_ESTIMATION__MIN_ROWS", "5")
    monkeypatch.setenv("SOO_ROBUST__DRIFT_TIME_H", "6.5")
    monkeypatch.setenv("SOO_OPERATIONS__GAIN_STEP_DB", "1.5")
    chain = Settings().chain_config()
    assert (chain.robust.drift_time_h, chain.operations.gain_step_db) == (6.5, 1.5)
    assert chain.interlock.validity_limit_deg == 0.35
    assert (chain.torque.min_pulse_s, chain.fade.depth_db, chain.estimation.min_rows) == (0.2, 0.4, 5)


@pytest.mark.parametrize(
    ("variable", "text"),
    [
        ("SOO_CLOCK", "sundial"),
        ("SOO_PORT", "70000"),
        ("SOO_PORT", "http"),
        ("SOO_LATE_AFTER_S", "-1"),
        ("SOO_MAX_BODY_BYTES", "10"),
        ("SOO_MAX_ROWS_PER_BATCH", "0"),
        ("SOO_LOG_LEVEL", "loud"),
        ("SOO_TRUSTED_PROXIES", "*"),
        ("SOO_ALLOWED_ORIGINS", "*"),
        ("SOO_ALLOWED_ORIGINS", "null"),
        ("SOO_ALLOWED_ORIGINS", "grafana.example"),
        ("SOO_ALLOWED_ORIGINS", "https://grafana.example/"),
        ("SOO_ALLOWED_ORIGINS", "https://Grafana.example"),
        ("SOO_ALLOWED_ORIGINS", "https://grafana.example:443"),
        ("SOO_ALLOWED_ORIGINS", "https://anna@grafana.example"),
        ("SOO_ALLOWED_ORIGINS", "https://grafana.example;https://openmct.example"),
        ("SOO_REQUEST_TIMEOUT_S", "0"),
        ("SOO_INTERLOCK__VALIDITY_LIMIT_DEG", "wide"),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(monkeypatch, variable, text):
    monkeypatch.setenv(variable, text)
    with pytest.raises(ValidationError, match=variable.removeprefix("SOO_").lower().split("__", maxsplit=1)[-1]):
        Settings()


def test_settings_cannot_be_changed_after_they_were_read():
    with pytest.raises(ValidationError):
        Settings().port = 1


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
    desk = build_alarms(Settings.model_validate(given), None, SystemClock(), LiveFeed(), lambda: 1, StepFailures())
    assert [channel.name for channel in desk.channels] == names


def test_limits_by_default_come_from_the_settings():
    given = {"alarms": {"attitude_warning_deg": 0.25}, "robust": {"disagreement_deg": 0.2}}
    desk = build_alarms(Settings.model_validate(given), None, SystemClock(), LiveFeed(), lambda: 1, StepFailures())
    assert desk.conditions["attitude_angle"].limits.warning == 0.25
    assert desk.conditions["methods_disagree"].limits.warning == 0.2
