"""The pages on exports and on archives that are sent: their blocks run as they stand against a service."""

from pathlib import Path
from typing import Any

import pytest
from page_blocks import CARRIERS, CRAFT, run_blocks

from service.client.service_client import ServiceClient

HOW_TO = Path(__file__).resolve().parents[2] / "docs" / "how-to"
#: what each block prints, in the order of the page
EXPORTED = [
    ("console", '"rows": 3'),
    ("console", '"file": "joined.csv"'),
    ("bash", "epoch,method,yaw_deg"),
    ("bash", '"rows":3'),
    ("python", "3 rows, -42.1 dBm in the mean"),
    ("console", "attitude.aem"),
    ("python", "star_tracker 0 new, 2 known"),
]
SENT = [
    ("console", '"rows": 3'),
    ("console", '"accepted": 3'),
    ("python", "3 0 0"),
    ("python", "1 True"),
    ("bash", '"accepted":1'),
]


@pytest.mark.slow
@pytest.mark.system
def test_exports(service: Any, tmp_path: Path) -> None:
    with ServiceClient(service.url, service.environment["SOO_KEY"], retries=6, timeout_s=120) as client:
        client.create_spacecraft(CRAFT)
        plan = client.put_carriers("yamal-202", CARRIERS)["plan_id"]
        rows = [{"epoch": f"2026-11-19T00:0{k}:00Z", "power_dbm": [-42.0 - k / 10, None]} for k in range(3)]
        assert client.post_measurements("yamal-202", plan, rows, source="sa-1")["accepted"] == 3
        reported = [
            {"epoch": f"2026-11-19T00:0{k}:00Z", "roll_deg": 0.1, "sigma_deg": {"roll": 0.01}} for k in range(2)
        ]
        assert client.post_references("yamal-202", "star_tracker", reported)["accepted"] == 2
    run_blocks(HOW_TO / "export-the-archive.md", EXPORTED, service.environment, tmp_path)


@pytest.mark.slow
@pytest.mark.system
def test_sent_archives(service: Any, tmp_path: Path) -> None:
    with ServiceClient(service.url, service.environment["SOO_KEY"], retries=6, timeout_s=120) as client:
        client.create_spacecraft(CRAFT)
        assert client.put_carriers("yamal-202", CARRIERS)["plan_id"] == 1
    lines = [f"2026-11-20T00:0{k}:00Z,-42.{k},-71.5,x" for k in range(3)]
    (tmp_path / "levels.csv").write_text("\n".join(["epoch,c00_dbm,c01_dbw,note", *lines]) + "\n")
    run_blocks(HOW_TO / "send-an-archive.md", SENT, service.environment, tmp_path)
