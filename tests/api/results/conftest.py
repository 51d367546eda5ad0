"""The application with all that computes behind it, over a real SQLite archive that tests fill through the ports."""

import asyncio
import uuid
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import httpx
import numpy as np
import pytest
from fastapi import FastAPI
from set_clock import NOW_US, SetClock
from shared_routes import with_shared_routes
from stored_records import attitude_row, torque_command

from db.storage import SqlStorage
from service.api.app import create_app
from service.api.context import ApiContext, Limits
from service.pipeline.alarms.conditions import condition_table
from service.pipeline.config import (
    AlarmConfig,
    AlignmentConfig,
    CalibrationConfig,
    ChainConfig,
    RobustConfig,
    TorqueConfig,
)
from service.pipeline.control.release.interlock_conditions import ReleaseSettings
from service.ports.archive import LIVE, ListPart, Outcome
from service.records.calibration import (
    Alignment,
    Calibration,
    CalibrationMethod,
    CalibrationRequest,
    CalibrationResult,
    CarrierCalibration,
    CarrierReference,
    Harmonic,
    NoiseComponent,
    Observability,
    Window,
)
from service.records.catalogue import (
    Carrier,
    ControlSettings,
    Ephemeris,
    Method,
    Onboard,
    Release,
    Site,
    Spacecraft,
    Station,
)
from service.records.levels.attitude import Axes
from service.records.levels.measurement import CarrierDetails, Measurement, MeasurementBatch
from service.records.operations.work import Job, JobKind, JobState, Replay
from service.runtime.alarms.alarm_service import AlarmService
from service.runtime.control.release_context import ReleasePublisher
from service.runtime.control.release_service import ReleaseService
from service.runtime.jobs.calibration import Aligner, CalibrationWork, Calibrator
from service.runtime.jobs.job_runner import JobPieces, JobRunner, Work
from service.runtime.jobs.replay import Replayer, replay_work
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.supervisor import Supervisor

KEY = "key-of-the-results"
S = 1_000_000
NAN = float("nan")
SC = "yamal-202"
INERTIA = ((2600.0, 0.0, 0.0), (0.0, 1400.0, 0.0), (0.0, 0.0, 2600.0))


def carrier(k: int, **changes: Any) -> Carrier:
    """Return one carrier of traffic."""
    plain = Carrier(
        f"c{k:02d}", "Ku", "Ku1", 11200e6 + k * 2e6, 1e6, Station(50.0, 40.0 + k), 14250e6, uplink_power_control="none"
    )
    return replace(plain, **changes)


def carrier_calibration(k: int, sensitivity: Axes, **changes: Any) -> CarrierCalibration:
    """Return the calibration of one carrier."""
    harmonic = Harmonic(0.35, -0.6, -42.0 - k, 86_328.0, NOW_US - 90_000 * S, 0.05 + 0.01 * k, 2800, 12)
    plain = CarrierCalibration(
        id=f"c{k:02d}",
        level_dbm=-42.0 - k,
        sigma_white_db=0.03,
        noise=(NoiseComponent(1200.0, 0.04),),
        harmonic=harmonic,
        sensitivity_db_per_deg=sensitivity,
        sensitivity_plus_db_per_deg=sensitivity,
        sensitivity_minus_db_per_deg=sensitivity,
        residual_db=0.06,
        stability_residual_rms_db=0.05 + 0.01 * k,
        drift_db_per_day=NAN,
        deviation_at_0p5_deg_db=0.02,
        nonlinearity_deg=0.03,
        linear_range_deg=0.5,
        axis="roll",
        axis_ratio=3.5,
        criteria_met=("stable", "linear", "dominant"),
        rejected_because=(),
        selected=True,
    )
    return replace(plain, **changes)


@dataclass
class Bench:
    """The service under test, and short words for filling its archive."""

    app: FastAPI
    context: ApiContext
    client: httpx.AsyncClient
    storage: SqlStorage
    clock: SetClock
    jobs: JobRunner

    @property
    def url(self) -> str:
        """Base of the spacecraft's paths."""
        return f"/api/v1/spacecraft/{SC}"

    async def get(self, path: str = "", **params: Any) -> Any:
        """Return the document under a path of the spacecraft."""
        answer = await self.client.get(self.url + path, params=params)
        assert answer.status_code == 200, answer.text
        return answer.json()

    async def refused(self, method: str, path: str, **options: Any) -> tuple[int, str, list[str]]:
        """Return status, code and pointers of a refusal."""
        answer = await self.client.request(method, f"/api/v1{path}", **options)
        problem = answer.json()
        assert answer.headers["content-type"] == "application/problem+json", answer.text
        assert problem["status"] == answer.status_code
        return answer.status_code, problem["code"], [error["pointer"] for error in problem["errors"]]

    def append(
        self,
        epochs_us: Sequence[int],
        power_dbm: Any = -42.1,
        *,
        source: str = "sa-1",
        plan_id: int = 1,
        flags: tuple[int, ...] | None = None,
        details: CarrierDetails | None = None,
    ) -> list[Measurement]:
        """Store rows and return those of the archive in order of epoch."""
        rows, width = len(epochs_us), len(self.storage.catalogue.plan(SC, plan_id).carriers)
        batch = MeasurementBatch(
            SC,
            source,
            plan_id,
            received_at_us=max(epochs_us) + 2 * S,
            index=np.arange(rows),
            epochs_us=np.asarray(epochs_us, dtype=np.int64),
            power_dbm=np.array(np.broadcast_to(np.asarray(power_dbm, dtype=np.float32), (rows, width))),
            flags=(flags,) * rows,
            is_stale=np.zeros(rows, dtype=bool),
            details=details,
        )
        receipt = self.storage.archive.append_measurements(batch).result(timeout=120)
        assert receipt.accepted == rows
        window = Window(min(epochs_us), max(epochs_us) + 1)
        return self.storage.archive.measurements(SC, ListPart(window, 100_000), source)

    def consume(self, outcomes: Sequence[Outcome] = (), version: str = LIVE) -> int:
        """Store outcomes as if the chain had consumed all there is."""
        head = self.storage.archive.head(SC)
        return self.storage.results.save_outcomes(SC, version, outcomes, head.newest_number, head.newest_epoch_us)

    def calibrate(
        self,
        carriers: Sequence[CarrierCalibration],
        *,
        is_active: bool = True,
        plan_id: int = 1,
        method: CalibrationMethod = CalibrationMethod.PAPER,
    ) -> Calibration:
        """Store a calibration with its figures."""
        results = self.storage.results
        request = CalibrationRequest(
            Window(NOW_US - 10, NOW_US), Window(NOW_US, NOW_US + 10), method, source_yaw="radio_beacon"
        )
        draft = results.add_calibration(SC, request, plan_id, 1, NOW_US, "engineer")
        observability = Observability(9.5, Axes(4.0, 0.5, 0.6), Axes(NAN, 0.02, 0.03))
        result = CalibrationResult(
            tuple(carriers), observability, {"quiet_rows": 2880.0, "turn_reach_deg": NAN}, ("few turns",)
        )
        done = results.finish_calibration(SC, draft.id, result, None)
        return results.activate_calibration(SC, draft.id) if is_active else done

    def align(self, epoch_us: int) -> Alignment:
        """Store an alignment under the newest calibration."""
        calibration = self.storage.results.calibrations(SC)[0]
        references = (CarrierReference("c00", -42.1, 0.01, 15, NAN),)
        wanted = Alignment(
            id=0,
            epoch_us=epoch_us,
            attitude_deg=Axes(0.1, 0.0, -0.1),
            sigma_deg=Axes(NAN, 0.01, 0.01),
            calibration_id=calibration.id,
            source="star_tracker",
            created_at_us=NOW_US,
            created_by="approver",
            references=references,
            window=Window(epoch_us - 900 * S, epoch_us + 1),
        )
        return self.storage.results.add_alignment(SC, wanted)

    def replay(self, state: JobState = JobState.DONE, progress: float = 1.0, error: str | None = None) -> str:
        """Store a replay whose job nobody runs, and return its version."""
        job = Job(f"replay-{uuid.uuid4().hex}", "replay", state, progress, NOW_US, error)
        self.storage.results.add_job(job, "nobody")
        wanted = Replay(0, 0, NOW_US, None, None, 1, "journal", job.id, NOW_US)
        return self.storage.results.add_replay(SC, wanted).version


@pytest.fixture
async def bench(storage: SqlStorage) -> AsyncIterator[Bench]:
    """A spacecraft with six carriers and an ephemeris; the supervisor is there but does not run."""
    storage.catalogue.add_spacecraft(
        Spacecraft(
            SC,
            "Yamal-202",
            90.0,
            Site(56.74, 37.19),
            INERTIA,
            0.05,
            onboard=Onboard(fast_loop=True, forecast_mode=True),
            control=ControlSettings(Method.PAPER, release=Release.AUTOMATIC),
        )
    )
    storage.catalogue.put_plan(SC, [carrier(k) for k in range(6)], "first")
    nodes_us = tuple(NOW_US + k * 86_328 * S for k in range(-3, 1))
    storage.catalogue.put_ephemeris(SC, Ephemeris(0, nodes_us, 86_328.0, nodes_us[0], nodes_us[-1], "nodes"))
    clock, feed, config = SetClock(), LiveFeed(capacity=50), ChainConfig()
    works: dict[str, Work] = {
        JobKind.CALIBRATION: CalibrationWork(storage, CalibrationConfig()),
        JobKind.REPLAY: partial(replay_work, storage, config),
    }
    jobs = JobRunner(storage, clock, JobPieces(works).advance)
    publisher = ReleasePublisher(storage.audit, feed, lambda _: None)
    context = ApiContext(
        storage=storage,
        clock=clock,
        supervisor=Supervisor(storage, feed, config),
        # its thread is not started: tests look when they want to
        alarms=AlarmService(storage, clock, feed, condition_table(AlarmConfig(), RobustConfig())),
        feed=feed,
        calibrator=Calibrator(storage, clock, jobs.notify, 2),
        aligner=Aligner(storage, clock, AlignmentConfig()),
        replayer=Replayer(storage, clock, jobs.notify),
        release_service=ReleaseService(
            storage, clock, ReleaseSettings(), TorqueConfig(), publisher, steady_us=clock.system_us
        ),
        bootstrap_key=KEY,
        limits=Limits(stream_heartbeat_s=0.3),
    )
    app = with_shared_routes(create_app(context))
    headers = {"Authorization": f"Bearer {KEY}"}
    transport = httpx.ASGITransport(app=app)
    jobs.start()
    async with httpx.AsyncClient(transport=transport, base_url="http://soo.test", headers=headers) as client:
        yield Bench(app, context, client, storage, clock, jobs)
    context.supervisor.stop()
    jobs.stop()
    await asyncio.get_running_loop().shutdown_default_executor()


@pytest.fixture
def make() -> SimpleNamespace:
    """Makers of records, and the instants and names that tests share."""
    return SimpleNamespace(
        key=KEY,
        now_us=NOW_US,
        sc=SC,
        row=attitude_row,
        command=torque_command,
        carrier=carrier,
        carrier_calibration=carrier_calibration,
        nan=NAN,
        s=S,
    )
