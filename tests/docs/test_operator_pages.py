"""Pages for an operator's first shift and for an own satellite: their blocks run as they stand."""

import csv
import json
import re
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from page_blocks import run_blocks
from release_ground import ReleaseGround, record, seed_archive

from analyzer_sim.__main__ import main
from service.api.schemas.carriers import CarrierDocument

AXES = ("yaw", "roll", "pitch")
NAMES = tuple(f"{axis}_deg" for axis in AXES)
HOW_TO = Path(__file__).resolve().parents[2] / "docs" / "how-to"
#: what each block of the first shift prints
SHIFT = (
    ("bash", "1 warning roll angle is 0.3"),
    ("console", '"spacecraft_id": "yamal-202"'),
    ("bash", "ACQUIRED ['unannounced_motion']"),
    ("bash", "event: status"),
    ("bash", '"state":"acknowledged"'),
    ("bash", '"kind":"station_keeping"'),
    ("bash", "unannounced_motion - roll or pitch moves"),
    ("bash", '"trips":["stop"]'),
    ("bash", '"text":"Roll alarm 1 acknowledged'),
)
#: what each block of the page for an own satellite prints
OWN = (
    ("bash", "spacecraft yamal-202 is stored"),
    ("bash", "plan 1 holds 16 carriers"),
    ("bash", "ephemeris 1 is in force until"),
    ("bash", "4890 accepted"),
    ("bash", "yaw sign proven warnings ['paper method: only 15"),
    ("bash", '"status":"ACQUIRED"'),
)


@pytest.fixture
def archive(tmp_path: Path) -> None:
    """A spacecraft that is calibrated, laid down before the service starts."""
    seed_archive(f"sqlite:///{tmp_path / 'archive.db'}", record("yamal-202"))


@pytest.mark.slow
@pytest.mark.system
def test_first_shift(archive: None, service: Any, tmp_path: Path) -> None:
    headers = {"Authorization": f"Bearer {service.environment['SOO_KEY']}"}
    with httpx.Client(base_url=service.url, headers=headers, timeout=120, trust_env=False) as client:
        ground = ReleaseGround(client, "yamal-202")
        ground.align()
        ground.rows(15, (0.0, 0.03, 0.0))
        ground.rows(15, (0.0, 0.34, 0.0))
        run_blocks(HOW_TO / "first-shift.md", SHIFT, service.environment, tmp_path)
        handover = client.get(f"{ground.base}/handover").json()
    assert handover["control"]["state"] == "TRIPPED"
    assert [note["tags"] for note in handover["notes"]] == [[], ["control"]]


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.system
def test_own_satellite(service: Any, tmp_path: Path) -> None:
    main(["export", "--scenario", "nominal", "--operation-days", "0.05", "--out", str(tmp_path / "world.npz")])
    with np.load(tmp_path / "world.npz") as world:
        lay_files(dict(world), tmp_path)
    run_blocks(HOW_TO / "your-own-satellite.md", OWN, service.environment, tmp_path)


def lay_files(world: dict[str, Any], folder: Path) -> None:
    """Write the files that the page takes as given: carriers, ephemeris, levels, sensor readings."""
    for line in json.loads(str(world["catalogue_json"])):
        if line["kind"] in ("carriers", "ephemeris"):
            (folder / f"{line['kind']}.json").write_text(json.dumps(line["body"]))
    with (folder / "levels.csv").open("w", newline="") as file:
        table = csv.writer(file, delimiter=";")
        table.writerow(["Time", *world["carrier_id"]])
        table.writerows(
            [without_zone(epoch), *("" if np.isnan(level) else f"{level:.3f}".replace(".", ",") for level in levels)]
            for epoch, levels in zip(world["epoch_us"], world["power_dbm"], strict=True)
        )
    angles = zip(*(world[f"reference_{axis}_deg"].tolist() for axis in AXES), strict=True)
    with (folder / "star-tracker.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["Time", *NAMES])
        table.writerows(
            [without_zone(epoch), *row] for epoch, row in zip(world["reference_epoch_us"], angles, strict=True)
        )


def without_zone(epoch_us: Any) -> str:
    """Return an epoch as programs write that know one zone only."""
    return str(np.datetime64(int(epoch_us), "us")).replace("T", " ")


def test_example_of_a_carrier_is_one() -> None:
    blocks = re.findall(
        r"^```json\n(.*?)^```", (HOW_TO / "your-own-satellite.md").read_text(), re.DOTALL | re.MULTILINE
    )
    assert CarrierDocument.model_validate_json(blocks[0]).id == "c00"
