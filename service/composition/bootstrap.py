"""Composition root: settings become adapters, adapters become an application.

It alone names db, and `job_process`, the composition root of the process that does the jobs.
"""

import asyncio
from collections.abc import Callable
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fastapi import FastAPI
from pydantic import SecretStr

from db.storage import SqlStorage
from service.api.access.auth import origins_of
from service.api.app import create_app
from service.api.context import ApiContext, Limits, MonitoringSettings
from service.api.monitoring.metrics import raised_descriptor_limit
from service.composition.job_process import JobSettings, clock_of, works_in_process
from service.composition.settings import Settings, entries_in_force
from service.console.pages import with_console
from service.pipeline.alarms.conditions import condition_table
from service.pipeline.checkpoints import fingerprint
from service.pipeline.first_rows import compile_rows
from service.ports.storage import Clock, Storage, Term
from service.records.operations.access import DONE, AccessKey, AuditEvent, Role, StoredKey, digest_of, new_key
from service.records.operations.alarms import Severity
from service.records.operations.work import JobKind
from service.runtime.alarms.alarm_service import AlarmService
from service.runtime.alarms.notifications import Mail, MailRoute, NoticeChannel, Webhook
from service.runtime.clock import SystemClock
from service.runtime.control.release_context import ReleasePublisher
from service.runtime.control.release_service import ReleaseService
from service.runtime.jobs.archive_maintenance import MaintenanceDue, MaintenanceWork
from service.runtime.jobs.calibration import Aligner, Calibrator
from service.runtime.jobs.job_runner import JobRunner, JobWorker, Standing
from service.runtime.jobs.replay import Replayer
from service.runtime.jobs.smoothing import SmoothingDue
from service.runtime.live.leadership import Leading
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.supervisor import StepFailures, Supervisor

if TYPE_CHECKING:
    from db.connection.engines import FileWatch
    from db.maintenance.doctor import ArchiveTools

#: descriptors that connections leave to the archive, logs and worker processes
_OWN_FILES = 256


def build_storage(settings: Settings) -> Storage:
    """Return the archive of the settings, made where there is none; ValueError for one of another layout."""
    storage = SqlStorage(settings.database_url, settings.database_timeout_s)
    storage.require_sessions()
    storage.prepare()
    return storage


def watch_file(settings: Settings) -> "FileWatch | None":
    """Return what tells whether another file has taken the place of the archive's; None for a server."""
    from db.connection.engines import FileWatch, sqlite_path

    path = sqlite_path(settings.database_url)
    if path is None:
        return None
    watch = FileWatch(path)
    watch.note()
    return watch


def build_clock(settings: Settings, storage: Storage) -> Clock:
    """Return the clock of the settings."""
    return clock_of(settings.clock, storage)


def open_storage(settings: Settings) -> Storage:
    """Return the archive of the settings, for commands that make none; ValueError where none of this layout is."""
    return storage_opener(settings)()


def storage_opener(settings: Settings) -> Callable[[], Storage]:
    """Return what opens the archive of the settings, also in another process, as `open_storage` does."""
    from db.connection.engines import absolute_url

    return partial(_opened, absolute_url(settings.database_url), settings.database_timeout_s)


def _opened(url: str, timeout_s: float) -> Storage:
    from db.connection.engines import sqlite_path

    path = sqlite_path(url)
    if path is not None and not path.is_file():
        message = f"there is no file {path}"
        raise ValueError(message)
    storage = SqlStorage(url, timeout_s)
    try:
        storage.require_layout()
    except BaseException:
        storage.close()
        raise
    return storage


def first_administrator(settings: Settings, storage: Storage) -> Path | None:
    """Return the file of a fresh administrator's key, when there is none and the settings give none; OSError.

    The archive keeps a digest. The file stands beside the archive, that of a server in the working directory.
    """
    from db.connection.engines import sqlite_path

    now_us = SystemClock().system_us()
    has_one = any(each.key.role is Role.ADMIN and each.key.is_valid(now_us) for each in storage.keys.all())
    if _secret(settings.bootstrap_key) or has_one:
        return None
    key_id, text = new_key()
    key = AccessKey(
        id=key_id, name="first administrator", role=Role.ADMIN, created_at_us=now_us, created_by="first start"
    )
    event = AuditEvent(
        at_us=now_us,
        who="service",
        key_id="",
        role="",
        address="",
        action="create_first_administrator",
        target=f"/keys/{key_id}",
        outcome=DONE,
        request_id="",
    )
    # first the file: a key that is stored and told to nobody would lock everybody out
    path = (sqlite_path(settings.database_url) or Path("soo.db")).resolve().with_name("administrator.key")
    if path.exists():
        path = path.with_name(f"administrator-{key_id}.key")
    path.touch(0o600, exist_ok=False)
    path.write_text(f"{text}\n")
    if storage.keys.add_first_administrator(StoredKey(key, digest_of(text.encode("ascii"))), event):
        return path
    # another service was quicker
    path.unlink()
    return None


def build_alarms(
    settings: Settings, storage: Storage, clock: Clock, feed: LiveFeed, turn: Term, failures: StepFailures
) -> AlarmService:
    """Return the alarm desk with the notices of the settings."""
    conditions = condition_table(settings.alarms, settings.robust)
    from_severity = Severity[settings.alarm_notices_from.upper()]
    channels = []
    url = _secret(settings.alarm_webhook_url)
    if url:
        webhook = Webhook(url, _secret(settings.alarm_webhook_secret), clock.system_us)
        channels.append(NoticeChannel("webhook", webhook.deliver, conditions, from_severity))
    if settings.alarm_mail_host and settings.alarm_mail_to:
        route = MailRoute(
            host=settings.alarm_mail_host,
            port=settings.alarm_mail_port,
            sender=settings.alarm_mail_from,
            receivers=tuple(part.strip() for part in settings.alarm_mail_to.split(",") if part.strip()),
            security=settings.alarm_mail_security,
            user=settings.alarm_mail_user or "",
            password=_secret(settings.alarm_mail_password),
        )
        channels.append(NoticeChannel("mail", Mail(route).deliver, conditions, from_severity))
    return AlarmService(
        storage,
        clock,
        feed,
        conditions,
        channels,
        check_period_s=settings.alarms.check_period_s,
        stale_periods=settings.alarms.stale_periods,
        turn=turn,
        failures=failures,
    )


def _secret(value: SecretStr | None) -> str:
    """Return a secret, empty when there is none."""
    return "" if value is None else value.get_secret_value()


def _chosen(settings: Settings, part: type[Any]) -> dict[str, Any]:
    """Return the settings that have the names of the fields of a part."""
    return {field.name: getattr(settings, field.name) for field in fields(part) if hasattr(settings, field.name)}


def _limits(settings: Settings) -> Limits:
    descriptors = max(64, raised_descriptor_limit() - _OWN_FILES)
    derived = {
        "retention_s": settings.retention.measurements_days * 86_400 or None,
        "rates": settings.rate_limit,
        "max_connections": min(settings.max_connections, descriptors),
        "trusted_proxies": settings.trusted_proxies or "",
        "allowed_origins": origins_of(settings.allowed_origins),
    }
    return Limits(**_chosen(settings, Limits) | derived)


def _stated(settings: Settings) -> dict[str, Any]:
    """Return the members of the interface's context that are settings."""
    return {
        "bootstrap_key": _secret(settings.bootstrap_key) or None,
        "limits": _limits(settings),
        "monitoring": MonitoringSettings(**_chosen(settings, MonitoringSettings)),
        "settings": entries_in_force(settings),
        "clock_kind": settings.clock,
        "calibration": settings.calibration,
        "interlock": settings.interlock,
    }


def build_maintenance(settings: Settings, storage: Storage, clock: Clock) -> MaintenanceWork:
    """Return what seals closed days and drops what is no longer kept."""
    return MaintenanceWork(storage, clock, settings.sealing, settings.retention)


def build_release_service(
    settings: Settings, storage: Storage, clock: Clock, feed: LiveFeed, notify: Callable[[str], None], leading: Leading
) -> ReleaseService:
    """Return the service that releases torques while this service leads; `notify` is told of new journal entries."""
    return ReleaseService(
        storage,
        clock,
        settings.release,
        settings.torque,
        ReleasePublisher(storage.audit, feed, notify),
        is_data_service=settings.clock == "data",
        turn=leading.term,
    )


def _job_runner(settings: Settings, storage: Storage, clock: Clock, leading: Leading) -> tuple[JobRunner, JobWorker]:
    of_jobs = JobSettings(**_chosen(settings, JobSettings) | {"chain": settings.chain_config()})
    make = partial(works_in_process, of_jobs)
    worker = JobWorker(make, storage.leases.lend, settings.workers.job_timeout_s)
    smoothing = SmoothingDue(storage, settings.smoothing, leading.term)
    maintenance = MaintenanceDue(storage, settings.sealing, leading.term)
    standing = (
        Standing(JobKind.SMOOTHING, smoothing.due, smoothing.failed),
        Standing(JobKind.SEALING, maintenance.due),
    )
    prepare = partial(worker.call, compile_rows)
    return JobRunner(storage, clock, worker.advance, leading.term, standing, prepare), worker


def build_app(settings: Settings, storage: Storage) -> FastAPI:
    """Return the application over an archive that is prepared; its start-up starts the supervisor and the jobs."""
    clock = build_clock(settings, storage)
    feed = LiveFeed()
    leading = Leading(storage.leases, is_estimator=settings.estimator, changed=lambda sc: supervisor.on_announced(sc))
    failures = StepFailures()
    alarms = build_alarms(settings, storage, clock, feed, leading.term, failures)
    release_service = build_release_service(settings, storage, clock, feed, lambda sc: supervisor.notify(sc), leading)
    supervisor = Supervisor(storage, feed, settings.chain_config(), alarms, leading.term, release_service, failures)
    jobs, worker = _job_runner(settings, storage, clock, leading)

    async def start() -> None:
        await asyncio.to_thread(leading.start, [jobs.take_over])
        jobs.start()
        alarms.start()
        supervisor.start()
        release_service.start()

    async def stop() -> None:
        running = (release_service.stop, supervisor.stop, alarms.stop)
        for end in (partial(jobs.stop, worker.stop), *running, leading.stop, storage.close):
            await asyncio.to_thread(end)

    context = ApiContext(
        storage=storage,
        clock=clock,
        is_following=lambda: supervisor.is_running,
        leaders=storage.leases.leaders,
        leader_silent_s=leading.silent_s,
        on_accepted=supervisor.notify,
        on_startup=start,
        on_shutdown=stop,
        supervisor=supervisor,
        alarms=alarms,
        feed=feed,
        calibrator=Calibrator(storage, clock, jobs.notify, settings.workers.max_calibrations),
        aligner=Aligner(storage, clock, settings.alignment),
        replayer=Replayer(storage, clock, jobs.notify, settings.workers.max_replays),
        release_service=release_service,
        **_stated(settings),
    )
    return with_console(create_app(context))


def open_archive_tools(database_url: str | None) -> "ArchiveTools":
    """Return what makes backups of an archive and looks at it; without a URL the archive of the settings."""
    # costs time that serving need not pay
    from db.maintenance.doctor import ArchiveTools

    settings = Settings.model_validate({})
    return ArchiveTools(database_url or settings.database_url, SystemClock(), fingerprint(settings.chain_config()))
