"""The page on exports: its blocks run as they stand against a service."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from service.client.service_client import ServiceClient

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "export-the-archive.md"
CRAFT = {
    "id": "yamal-202",
    "name": "Yamal-202",
    "longitude_deg": 90.0,
    "simulated": True,
    "receiving_site": {"name": "site", "latitude_deg": 55.0, "longitude_deg": 38.0, "height_m": 200.0},
    "inertia_kg_m2": [[4000, 0, 0], [0, 2000, 0], [0, 0, 4000]],
    "torque_limit_n_m": 0.05,
}
CARRIERS = [
    {"id": each, "band": "Ku", "transponder": "Ku1", "downlink_hz": 11.2e9, "bandwidth_hz": 1e3, "kind": "beacon"}
    for each in ("c00", "c01")
]
#: what each block prints, in the order of the page
WANTED = [
    ("console", '"rows": 3'),
    ("bash", "epoch,method,yaw_deg"),
    ("bash", '"rows":3'),
    ("python", "3 rows, -42.1 dBm in the mean"),
    ("console", "attitude.aem"),
    ("python", "star_tracker 0 new, 2 known"),
]


def blocks() -> list[tuple[str, str]]:
    """Return language and text of every block that can be run; commands of a console each on their own."""
    found = re.findall(r"^```(bash|python|console)\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    return [
        (language, command)
        for language, text in found
        for command in (re.findall(r"^\$ (soo .*)$", text, re.MULTILINE) if language == "console" else [text])
    ]


@pytest.mark.system
@pytest.mark.timeout(120)  # 10 s alone; the machine may be busy with other tests
def test_the_blocks_run_as_they_stand(service: Any, tmp_path: Path) -> None:
    with ServiceClient(service.url, service.environment["SOO_KEY"], retries=6) as client:
        client.create_spacecraft(CRAFT)
        plan = client.put_carriers("yamal-202", CARRIERS)["plan_id"]
        rows = [{"epoch": f"2026-11-19T00:0{k}:00Z", "power_dbm": [-42.0 - k / 10, None]} for k in range(3)]
        assert client.post_measurements("yamal-202", plan, rows, source="sa-1")["accepted"] == 3
        told = [{"epoch": f"2026-11-19T00:0{k}:00Z", "roll_deg": 0.1, "sigma_deg": {"roll": 0.01}} for k in range(2)]
        assert client.post_references("yamal-202", "star_tracker", told)["accepted"] == 2
    environment = service.environment | {"SOO_URL": service.url}
    assert [language for language, _ in blocks()] == [language for language, _ in WANTED]
    for (language, text), (_, wanted) in zip(blocks(), WANTED, strict=True):
        if language == "python":
            command = [sys.executable, "-c", text]
        else:
            command = ["bash", "-c", text.strip() + (" --json" if language == "console" else "")]
        done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        assert wanted in done.stdout
