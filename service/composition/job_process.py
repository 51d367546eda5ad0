"""Composition root of the process that does the jobs: storage and works, without the interface.

The process imports this module alone: the interface would take 0.8 s of its start and 35 MB, while the service that
has just started brings its chains back beside it.
"""

from dataclasses import dataclass
from functools import partial

from db.storage import SqlStorage
from service.pipeline.config import CalibrationConfig, ChainConfig
from service.ports.storage import Clock, Storage
from service.records.operations.work import JobKind
from service.records.storage import RetentionConfig, SealingConfig
from service.runtime.clock import DataClock, SystemClock
from service.runtime.jobs.archive_maintenance import MaintenanceWork
from service.runtime.jobs.calibration import CalibrationWork
from service.runtime.jobs.job_runner import Work
from service.runtime.jobs.replay import replay_work
from service.runtime.jobs.smoothing import SmoothingConfig, SmoothingWork


@dataclass(frozen=True, slots=True)
class JobSettings:
    """Settings of jobs, without secrets: they go to another process."""

    database_url: str
    database_timeout_s: float
    clock: str
    chain: ChainConfig
    calibration: CalibrationConfig
    smoothing: SmoothingConfig
    sealing: SealingConfig
    retention: RetentionConfig


def clock_of(kind: str, storage: Storage) -> Clock:
    """Return the clock of a kind."""
    if kind == "system":
        return SystemClock()
    return DataClock(
        lambda spacecraft_id: storage.catalogue.spacecraft(spacecraft_id).simulated,
        lambda spacecraft_id: storage.archive.head(spacecraft_id).newest_epoch_us,
    )


def works_in_process(settings: JobSettings) -> tuple[Storage, dict[str, Work]]:
    """Return a storage of the process and what does the jobs, by kind."""
    storage = SqlStorage(settings.database_url, settings.database_timeout_s)
    clock = clock_of(settings.clock, storage)
    works: dict[str, Work] = {
        JobKind.CALIBRATION: CalibrationWork(storage, settings.calibration),
        JobKind.SMOOTHING: SmoothingWork(storage, settings.chain, settings.smoothing),
        JobKind.SEALING: MaintenanceWork(storage, clock, settings.sealing, settings.retention),
        JobKind.REPLAY: partial(replay_work, storage, settings.chain),
    }
    return storage, works
