"""About: version, clock, settings in force, licences; no secret in any of it."""

import json
from importlib.metadata import version

import httpx
import pytest

from service.composition.bootstrap import build_app, build_storage
from service.composition.settings import Settings
from service.records.epoch import format_epoch

pytestmark = pytest.mark.anyio


async def test_version_clock_and_licences(soo):
    answer = (await soo.client.get("/api/v1/about")).json()
    assert answer["version"] == version("soo")
    assert answer["clock"] == {"now": format_epoch(soo.clock.system_us()), "kind": "system"}
    licences = {each["name"]: each["licence"] for each in answer["shipped"]}
    assert next(iter(licences)) == "soo"
    assert licences["soo"] == "Apache-2.0"
    assert {"numpy", "fastapi", "starlette"} <= licences.keys()
    assert "pytest" not in licences


async def test_settings_are_shown_without_secrets(tmp_path, monkeypatch):
    """Each with value, default, unit and source; of what is secret only that it is set."""
    folder = tmp_path / "secrets"
    folder.mkdir()
    (folder / "soo_alarm_webhook_secret").write_text("hidden-1")
    monkeypatch.setenv("SOO_SECRETS_DIR", str(folder))
    monkeypatch.setenv("SOO_BOOTSTRAP_KEY", "hidden-2")
    monkeypatch.setenv("SOO_ALARM_WEBHOOK_URL", "https://user:hidden-3@hooks.test/T0/hidden-4")
    monkeypatch.setenv("SOO_ALARM_MAIL_PASSWORD", "hidden-5")
    monkeypatch.setenv("SOO_INTERLOCK__VALIDITY_LIMIT_DEG", "0.35")
    settings = Settings(database_url=f"sqlite:///{tmp_path}/soo.db", clock="data")
    app = build_app(settings, build_storage(settings))
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app=app), base_url="http://soo.test") as client:
        answer = await client.get("/api/v1/about", headers={"Authorization": "Bearer hidden-2"})
        await app.state.context.on_shutdown()
    assert answer.status_code == 200
    assert "hidden" not in answer.text
    shown = {each.pop("name"): each for each in answer.json()["settings"]}
    assert (
        shown["SOO_INTERLOCK__VALIDITY_LIMIT_DEG"].items()
        >= {"value": "0.35", "default": "0.4", "unit": "deg", "source": "environment"}.items()
    )
    sources = {name: (each["value"], each["source"]) for name, each in shown.items()}
    assert sources["SOO_BOOTSTRAP_KEY"] == sources["SOO_ALARM_WEBHOOK_URL"] == ("(set)", "environment")
    assert sources["SOO_ALARM_WEBHOOK_SECRET"] == ("(set)", "file")
    assert sources["SOO_CLOCK"] == ("data", "option")
    assert sources["SOO_PORT"] == ("8000", "default")
    assert answer.json()["clock"]["kind"] == "data"
    assert len(json.dumps(shown)) < 100_000


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("sqlite:////srv/soo.db", "sqlite:////srv/soo.db"),
        ("postgresql+psycopg://u:p@db.test:5432/soo", "postgresql+psycopg://***@db.test:5432/soo"),
        ("postgresql://u:p#a/b?c@d@db.test/soo?password=p", "postgresql://***@db.test/soo?***"),
        ("postgresql://db.test/soo?user=u&password=p@q", "postgresql://***@q"),
    ],
)
async def test_a_url_is_shown_without_what_it_hides(url, expected):
    from service.composition.setting_entries import setting_entries

    entries = setting_entries(Settings(database_url=url))
    assert next(entries).value == expected
