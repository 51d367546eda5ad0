"""Archive that the tests open, estimate from and export, and the values that must come of it.

``make archive`` makes both new. It is a SQLite file as a stopped service leaves it: a morning of operation, sealed,
with summaries, checkpoints and an audit log.
"""

import asyncio
import hashlib
import json
import lzma
import math
import tempfile
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import httpx
from busy_station import BOTH, SC, Station, at, morning
from fastapi import FastAPI
from stored_records import AUDIT_EVENT

from service.composition.bootstrap import build_app
from service.composition.settings import Settings
from service.records.levels.attitude import AttitudeRow

FOLDER = Path(__file__).resolve().parents[2] / "unit" / "db" / "archive"
ARCHIVE, EXPECTED = FOLDER / "archive.db.xz", FOLDER / "expected.json"
#: minutes of operation that the archive does not hold yet
NEXT = range(141, 161)
_EVER = 1 << 60
_KEY = "soo_" + "fixture" * 7
_EXPORTS = (
    "measurements:export",
    "attitude:export?method=robust",
    "attitude:export?method=paper",
    "torques:export",
)


def unpacked(folder: Path) -> Path:
    """Write the stored archive into a folder and return its path."""
    path = folder / "soo.db"
    path.write_bytes(lzma.decompress(ARCHIVE.read_bytes()))
    return path


def values(folder: Path) -> dict[str, object]:
    """Return what comes of the archive in a folder: exports of what is stored, then estimates from further rows."""
    url = f"sqlite:///{folder / 'soo.db'}"
    station = Station(folder)
    with closing(station):
        station.storage.prepare()
        exports = asyncio.run(_exports(build_app(Settings(database_url=url, bootstrap_key=_KEY), station.storage)))
        with station.supervised() as settle:
            station.send(NEXT, source="sa-2")
            settle()
        angles = {method.value: [_angles(row) for row in station.rows(method, start=NEXT.start)] for method in BOTH}
        impulses = [list(command.impulse_n_m_s) for command in station.commands(start=NEXT.start)]
        return {"exports": exports, "angles_deg": angles, "impulses_n_m_s": impulses}


async def _exports(app: FastAPI) -> dict[str, object]:
    """Return rows and hash of each series as CSV."""
    exports = {}
    headers = {"Authorization": f"Bearer {_KEY}"}
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://soo", headers=headers) as client:
        for query in _EXPORTS:
            answer = await client.get(f"/api/v1/spacecraft/{SC}/archive/{query}")
            assert answer.status_code == 200, answer.text
            digest = hashlib.sha256(answer.content).hexdigest()
            exports[query] = {"rows": len(answer.text.splitlines()) - 1, "sha256": digest}
    return exports


def _angles(row: AttitudeRow) -> list[float | None]:
    return [None if math.isnan(angle) else angle for angle in row.attitude_deg]


def make() -> None:
    """Write archive and expected values."""
    FOLDER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        station = Station(folder)
        with closing(station):
            station.open()
            with station.supervised() as settle:
                for _ in morning(station):
                    settle()
            storage = station.storage
            storage.audit.append(replace(AUDIT_EVENT, at_us=at(0)))
            list(storage.archive.seal(SC, _EVER, _EVER))
            list(storage.results.seal(SC, _EVER))
        ARCHIVE.write_bytes(lzma.compress((folder / "soo.db").read_bytes(), preset=9))
        EXPECTED.write_text(json.dumps(values(folder), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    make()
