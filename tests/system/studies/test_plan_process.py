"""``soo plan`` as a process of its own: against a service that has a calibration, and against one that has none."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import httpx
import pytest
from synthetic_payload import SC, SyntheticPayload

from db.storage import SqlStorage

pytestmark = pytest.mark.system

KEY = "a-key-for-tests-only"
PAYLOAD = SyntheticPayload.make(18)


def calibrated(database: Path) -> None:
    """Make an archive with a spacecraft, a plan over three transponders, and a calibration."""
    storage = SqlStorage(f"sqlite:///{database}")
    storage.prepare()
    storage.catalogue.add_spacecraft(PAYLOAD.spacecraft())
    carriers = [replace(carrier, transponder=f"K{k % 3}") for k, carrier in enumerate(PAYLOAD.carriers())]
    plan = storage.catalogue.put_plan(SC, carriers, "three")
    ephemeris = storage.catalogue.put_ephemeris(SC, PAYLOAD.ephemeris())
    known = PAYLOAD.calibration()
    draft = storage.results.add_calibration(SC, known.request, plan.id, ephemeris.id, known.created_at_us, "engineer")
    storage.results.finish_calibration(SC, draft.id, known.result, None)
    storage.close()


@pytest.fixture(scope="module")
def url(serving, tmp_path_factory):
    """Address of a service with a calibrated spacecraft."""
    database = tmp_path_factory.mktemp("plan") / "calibrated.db"
    calibrated(database)
    with serving(database) as service:
        yield service.url


def soo_plan(url: str, environment: dict[str, str], *options: str) -> subprocess.CompletedProcess[str]:
    """Run the command."""
    command = [sys.executable, "-m", "service", "plan", "--service", url, *options]
    return subprocess.run(
        command, env={**environment, "SOO_KEY": KEY}, capture_output=True, text=True, timeout=120, check=False
    )


def test_a_calibrated_service_chooses(url, compiled_environment, tmp_path):
    figure = tmp_path / "map.png"
    ended = soo_plan(url, compiled_environment, "--spacecraft", SC, "--count", "12", "--figure", str(figure))
    assert ended.returncode == 0, ended.stderr
    assert f"{SC}: 18 carriers by calibration 1 (paper), rule optimal" in ended.stdout
    assert "Recommended turns, 8.5 h in all" in ended.stdout
    assert figure.read_bytes().startswith(b"\x89PNG")
    ended = soo_plan(url, compiled_environment, "--spacecraft", SC, "--count", "12", "--json")
    document = json.loads(ended.stdout)
    assert len(document["selected"]) == 12
    assert document["sufficient"] is True


def test_refusals_of_the_service_are_its_words(url, compiled_environment, spacecraft):
    headers = {"Authorization": f"Bearer {KEY}"}
    answer = httpx.post(f"{url}/api/v1/spacecraft", json=spacecraft, headers=headers, trust_env=False, timeout=120)
    assert answer.status_code == 201
    ended = soo_plan(url, compiled_environment, "--spacecraft", "sim-1")
    assert ended.returncode == 1
    assert "no calibration of sim-1 has figures to choose carriers by" in ended.stderr
    assert "Traceback" not in ended.stderr
