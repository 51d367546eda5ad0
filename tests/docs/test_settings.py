"""The page of settings says what the code does: every setting, its default, and that its variable works."""

import re
from pathlib import Path

import pytest
from pydantic import SecretStr
from typer.testing import CliRunner

from service.cli.app import app
from service.cli.settings_reference import settings_markdown
from service.composition.setting_entries import setting_entries
from service.composition.settings import Settings
from service.records.setting import ORIGINS

ROOT = Path(__file__).resolve().parents[2]
DEFAULTS = list(setting_entries(Settings.model_construct()))


@pytest.fixture(autouse=True)
def _clean_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take away what the environment says about settings."""
    for entry in DEFAULTS:
        monkeypatch.delenv(entry.name, raising=False)


def test_page_is_current() -> None:
    page = (ROOT / "docs" / "reference" / "settings.md").read_text()
    assert page == settings_markdown(), "run: soo settings --markdown --output docs/reference/settings.md"


def test_each_setting_has_meaning_and_origin() -> None:
    assert len(DEFAULTS) == len({entry.name for entry in DEFAULTS}) >= 40
    for entry in DEFAULTS:
        assert entry.meaning, entry.name
        assert entry.origin in ORIGINS, entry.name


@pytest.mark.parametrize("name", [entry.name for entry in DEFAULTS])
def test_each_variable_reaches_its_setting(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    default = next(entry.default for entry in DEFAULTS if entry.name == name)
    special = {"SOO_CLOCK": "data", "SOO_LOG_LEVEL": "debug", "SOO_KERNELS": "numpy", "SOO_BOOTSTRAP_KEY": "a-secret"}
    special["SOO_TRUSTED_PROXIES"] = "10.0.0.1"
    special["SOO_ALLOWED_ORIGINS"] = "https://grafana.example,http://[::1]:3000"
    special |= {"SOO_LOG_FORMAT": "text", "SOO_ACCESS_LOG": "False", "SOO_METRICS_NEED_KEY": "True"}
    special |= {"SOO_ESTIMATOR": "False", "SOO_PLAIN_SESSIONS": "True"}
    special |= {"SOO_ALARM_NOTICES_FROM": "critical", "SOO_ALARM_MAIL_SECURITY": "tls"}
    is_number = re.fullmatch(r"\d+(\.\d+)?(e-?\d+)?", default)
    other = special.get(name) or (str(type_of(default)(float(default) * 2.0 or 3.0)) if is_number else f"{default}x")
    monkeypatch.setenv(name, other)
    entries = list(setting_entries(Settings.model_validate({})))
    changed = {entry.name: entry.value for entry in entries if entry.value != entry.default}
    assert list(changed) == [name]
    is_secret = isinstance(getattr(Settings.model_validate({}), name.removeprefix("SOO_").lower(), None), SecretStr)
    assert changed[name] == ("(set)" if is_secret else other)


def type_of(default: str) -> type[int] | type[float]:
    """Return the type of a number as it is printed."""
    return int if default.isdigit() else float


def test_values_in_force_are_printed_without_secrets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOO_BOOTSTRAP_KEY", "never-print-me")
    monkeypatch.setenv("SOO_INTERLOCK__VALIDITY_LIMIT_DEG", "0.35")
    result = CliRunner().invoke(app, ["settings"])
    assert result.exit_code == 0, result.output
    assert "never-print-me" not in result.output
    assert re.search(r"^\* SOO_INTERLOCK__VALIDITY_LIMIT_DEG +0\.35$", result.output, re.MULTILINE)
    assert re.search(r"^  SOO_PORT +8000$", result.output, re.MULTILINE)
