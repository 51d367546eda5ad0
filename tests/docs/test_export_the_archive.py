"""The page on exports: its blocks run as they stand against a service."""

from pathlib import Path
from typing import Any

import pytest
from page_blocks import CARRIERS, CRAFT, run_blocks

from service.client.service_client import ServiceClient

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "export-the-archive.md"
#: what each block prints, in the order of the page
WANTED = [
    ("console", '"rows": 3'),
    ("bash", "epoch,method,yaw_deg"),
    ("bash", '"rows":3'),
    ("python", "3 rows, -42.1 dBm in the mean"),
    ("console", "attitude.aem"),
    ("python", "star_tracker 0 new, 2 known"),
]


@pytest.mark.system
def test_the_blocks_run_as_they_stand(service: Any, tmp_path: Path) -> None:
    with ServiceClient(service.url, service.environment["SOO_KEY"], retries=6) as client:
        client.create_spacecraft(CRAFT)
        plan = client.put_carriers("yamal-202", CARRIERS)["plan_id"]
        rows = [{"epoch": f"2026-11-19T00:0{k}:00Z", "power_dbm": [-42.0 - k / 10, None]} for k in range(3)]
        assert client.post_measurements("yamal-202", plan, rows, source="sa-1")["accepted"] == 3
        told = [{"epoch": f"2026-11-19T00:0{k}:00Z", "roll_deg": 0.1, "sigma_deg": {"roll": 0.01}} for k in range(2)]
        assert client.post_references("yamal-202", "star_tracker", told)["accepted"] == 2
    environment = service.environment | {"SOO_URL": service.url}
    run_blocks(PAGE, WANTED, environment, tmp_path)
