"""The page on releasing torques runs as it stands: a torque goes from preparation to report by two persons."""

import json
from pathlib import Path
from typing import Any

import httpx
import pytest
from page_blocks import run_blocks
from release_ground import ReleaseGround, record, seed_archive

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "how-to" / "release-a-torque.md"
#: language of each block and what it must print
PRINTED = (
    ("bash", '"state":"INHIBITED"'),
    ("bash", '"state":"ARMED"'),
    ("python", "envelope ok\n"),
    ("bash", '"state":"PREPARED"'),
    ("python", "Anna wants: roll is off\nRELEASED\n"),
    ("bash", '"state":"SENT"'),
    ("python", "EXECUTED "),
    ("bash", '"trips":["stop"]'),
    ("bash", '"state":"INHIBITED"'),
)


@pytest.fixture
def archive(tmp_path: Path) -> None:
    """A spacecraft that is calibrated, laid down before the service starts."""
    seed_archive(f"sqlite:///{tmp_path / 'archive.db'}", record("yamal-202"))


@pytest.mark.system
@pytest.mark.slow
def test_the_blocks_run_as_they_stand(archive: None, service: Any, tmp_path: Path) -> None:
    headers = {"Authorization": f"Bearer {service.environment['SOO_KEY']}"}
    with httpx.Client(base_url=service.url, headers=headers, timeout=120, trust_env=False) as client:
        ground = ReleaseGround(client, "yamal-202")
        ground.align()
        ground.rows(15, (0.0, 0.03, 0.0))
        keys = {"ANNA_KEY": ground.key("Anna", "operator"), "BORIS_KEY": ground.key("Boris", "approver")}
        run_blocks(PAGE, PRINTED, {**service.environment, **keys}, tmp_path)
        notes = client.get("/api/v1/notes", params={"spacecraft_id": "yamal-202"}).json()["rows"]
    uplink = json.loads((tmp_path / "uplink.json").read_text())
    assert (uplink["counter"], uplink["simulated"], uplink["form"]) == (1, True, "torques")
    assert [note["text"] for note in notes] == [
        "arm: roll drifts, correction before the night",
        "stop: unexpected motion",
    ]


def test_codes_of_the_table_are_those_of_the_reference() -> None:
    codes = [
        line.split("`")[1] for line in PAGE.read_text().partition("| code | do |")[2].splitlines() if "| `" in line
    ]
    reference = (ROOT / "docs" / "reference" / "errors.md").read_text()
    assert len(codes) >= 10
    assert [code for code in codes if f"| `{code}` |" not in reference] == []
