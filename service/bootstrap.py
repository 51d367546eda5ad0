"""Composition root: settings become adapters, adapters become an application. The only module that names db."""

import asyncio
import secrets

from fastapi import FastAPI

from db.storage import SqlStorage
from service.api.app import create_app
from service.api.deps import ApiContext, Limits
from service.ports import Clock, Storage
from service.runtime.aligning import Aligner
from service.runtime.calibrating import Calibrator
from service.runtime.clock import DataClock, SystemClock
from service.runtime.jobs import JobRunner
from service.runtime.live_feed import LiveFeed
from service.runtime.replaying import Replayer
from service.runtime.supervisor import Supervisor
from service.runtime.upkeep import Upkeep
from service.settings import Settings


def build_storage(settings: Settings) -> Storage:
    """Return the archive of the settings with its schema brought to the present version."""
    storage = SqlStorage(settings.database_url)
    storage.migrate()
    return storage


def build_clock(settings: Settings, storage: Storage) -> Clock:
    """Return the clock of the settings."""
    if settings.clock == "system":
        return SystemClock()
    return DataClock(
        lambda spacecraft_id: storage.catalogue.spacecraft(spacecraft_id).simulated,
        lambda spacecraft_id: storage.archive.head(spacecraft_id).newest_epoch_us,
    )


def administrator_key(settings: Settings) -> tuple[str, bool]:
    """Return the administrator's key and whether it was made just now; an empty setting is none."""
    given = settings.bootstrap_key.get_secret_value() if settings.bootstrap_key is not None else ""
    if given:
        return given, False
    return secrets.token_urlsafe(32), True


def build_app(settings: Settings, storage: Storage, key: str) -> FastAPI:
    """Return the application over a migrated archive; its start-up starts the supervisor and the jobs."""
    clock = build_clock(settings, storage)
    feed = LiveFeed()
    supervisor = Supervisor(storage, feed, settings.chain_config())
    jobs = JobRunner(storage.results, clock)

    upkeep = Upkeep(storage, clock, settings.sealing, settings.retention)

    async def start() -> None:
        jobs.start()
        upkeep.start()
        supervisor.start()

    async def stop() -> None:
        await asyncio.to_thread(supervisor.stop)
        await asyncio.to_thread(jobs.stop)
        await asyncio.to_thread(upkeep.stop)
        await asyncio.to_thread(storage.close)

    context = ApiContext(
        storage=storage,
        clock=clock,
        bootstrap_key=key,
        limits=Limits(
            future_tolerance_s=settings.future_tolerance_s,
            future_tolerance_data_s=settings.future_tolerance_data_s,
            late_after_s=settings.late_after_s,
            retention_s=settings.retention.measurements_days * 86_400 or None,
            max_body_bytes=settings.max_body_bytes,
            max_rows_per_batch=settings.max_rows_per_batch,
            evidence_traces=settings.evidence_traces,
            evidence_bytes=settings.evidence_bytes,
        ),
        on_accepted=supervisor.notify,
        on_startup=start,
        on_shutdown=stop,
        supervisor=supervisor,
        feed=feed,
        calibrator=Calibrator(storage, clock, jobs, settings.calibration),
        aligner=Aligner(storage, clock, settings.alignment),
        replayer=Replayer(storage, clock, jobs, settings.chain_config()),
        calibration=settings.calibration,
        kernels=settings.kernels,
    )
    return create_app(context)
