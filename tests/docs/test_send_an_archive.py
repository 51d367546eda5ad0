"""The page on archives: its blocks run as they stand against a service."""

from pathlib import Path
from typing import Any

import pytest
from page_blocks import CARRIERS, CRAFT, run_blocks

from service.client.service_client import ServiceClient

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "send-an-archive.md"
#: what each block prints, in the order of the page
WANTED = [
    ("console", '"rows": 3'),
    ("console", '"accepted": 3'),
    ("python", "3 0 0"),
    ("python", "1 True"),
    ("bash", '"accepted":1'),
]


@pytest.mark.system
def test_the_blocks_run_as_they_stand(service: Any, tmp_path: Path) -> None:
    with ServiceClient(service.url, service.environment["SOO_KEY"], retries=6) as client:
        client.create_spacecraft(CRAFT)
        assert client.put_carriers("yamal-202", CARRIERS)["plan_id"] == 1
    lines = [f"2026-11-20T00:0{k}:00Z,-42.{k},-71.5,x" for k in range(3)]
    (tmp_path / "levels.csv").write_text("\n".join(["epoch,c00_dbm,c01_dbw,note", *lines]) + "\n")
    environment = service.environment | {"SOO_URL": service.url}
    run_blocks(PAGE, WANTED, environment, tmp_path)
