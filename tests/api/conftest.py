"""The application over a real SQLite archive, spoken to through ASGI; the clock stands where a test puts it."""

import asyncio
import shutil
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import httpx
import pytest
from fastapi import FastAPI
from set_clock import SetClock
from shared_routes import with_shared_routes

from db.storage import SqlStorage
from service.api.app import create_app
from service.api.context import ApiContext, Limits
from service.pipeline.config import TorqueConfig
from service.pipeline.control.release.interlock_conditions import ReleaseSettings
from service.runtime.control.release_context import ReleasePublisher
from service.runtime.control.release_service import ReleaseService
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.supervisor import StepFailures

KEY = "test-key-of-the-administrator"


@dataclass
class Soo:
    """The service under test and all that a test may want to look at."""

    app: FastAPI
    client: httpx.AsyncClient
    storage: SqlStorage
    clock: SetClock
    accepted: list[str]

    async def with_plan(self, spacecraft: dict[str, Any], carriers: list[dict[str, Any]]) -> int:
        """Add a spacecraft and a plan; return the plan's number."""
        created = await self.client.post("/api/v1/spacecraft", json=spacecraft)
        assert created.status_code == 201, created.text
        put = await self.client.put(f"/api/v1/spacecraft/{spacecraft['id']}/carriers", json={"carriers": carriers})
        assert put.status_code == 200, put.text
        self.accepted.clear()
        return int(put.json()["plan_id"])


@pytest.fixture
def storage(empty_database: Path, tmp_path: Path) -> Iterator[SqlStorage]:
    path = tmp_path / "soo.db"
    shutil.copy(empty_database, path)
    opened = SqlStorage(f"sqlite:///{path}")
    yield opened
    opened.close()


@pytest.fixture
async def soo(storage: SqlStorage) -> AsyncIterator[Soo]:
    clock, accepted = SetClock(), list[str]()
    limits = Limits(max_body_bytes=200_000, max_rows_per_batch=200)
    context = ApiContext(
        storage=storage,
        clock=clock,
        # the routes under these tests store and list; none of them may ask for what computes
        supervisor=cast(
            "Any",
            SimpleNamespace(
                restarts=SimpleNamespace(under_way=None),
                failures=StepFailures(),
                is_disagreeing=lambda _: False,
                newest_results=lambda *_: None,
            ),
        ),
        alarms=cast("Any", None),
        feed=cast("Any", None),
        calibrator=cast("Any", None),
        aligner=cast("Any", None),
        replayer=cast("Any", None),
        release_service=ReleaseService(
            storage,
            clock,
            ReleaseSettings(),
            TorqueConfig(),
            ReleasePublisher(storage.audit, LiveFeed(), accepted.append),
            steady_us=clock.system_us,
        ),
        bootstrap_key=KEY,
        limits=limits,
        on_accepted=lambda spacecraft_id, *_: accepted.append(spacecraft_id),
    )
    app = with_shared_routes(create_app(context))
    transport = httpx.ASGITransport(app=app)
    headers = {"Authorization": f"Bearer {KEY}"}
    async with httpx.AsyncClient(transport=transport, base_url="http://soo.test", headers=headers) as client:
        yield Soo(app, client, storage, clock, accepted)
    await asyncio.get_running_loop().shutdown_default_executor()


@pytest.fixture
def spacecraft() -> dict[str, Any]:
    """The spacecraft of the contract."""
    return {
        "id": "yamal-202",
        "name": "Yamal-202",
        "cospar_id": "2003-053B",
        "longitude_deg": 90.0,
        "receiving_site": {"name": "Dubna", "latitude_deg": 56.74, "longitude_deg": 37.19, "height_m": 120.0},
        "inertia_kg_m2": [[2600, 0, 0], [0, 1400, 0], [0, 0, 2600]],
        "torque_limit_n_m": 0.05,
    }


@pytest.fixture
def carriers() -> list[dict[str, Any]]:
    """Three carriers and a beacon."""
    traffic = [
        {
            "id": f"c{k:02d}",
            "name": f"Carrier {k}",
            "station": {"name": f"Station {k}", "latitude_deg": 50.0 + k, "longitude_deg": 40.0 + 10 * k},
            "band": "Ku",
            "transponder": "Ku1",
            "polarization": "H",
            "uplink_hz": 14250e6 + k * 2e6,
            "downlink_hz": 11200e6 + k * 2e6,
            "intermediate_hz": 958.2e6 + k * 2e6,
            "bandwidth_hz": 1.25e6,
        }
        for k in range(3)
    ]
    beacon = {
        "id": "b0",
        "band": "Ku",
        "transponder": "Ku1",
        "downlink_hz": 11199e6,
        "bandwidth_hz": 1e3,
        "kind": "beacon",
    }
    return [*traffic, beacon]
