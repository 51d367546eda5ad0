"""Settings: read once from the environment, prefix ``SOO_``, and turned into frozen configurations.

Nested settings use a double underscore: ``SOO_INTERLOCK__VALIDITY_LIMIT_DEG=0.35``. Defaults are those of the
publication where it states one, else tuned on the simulator's truth; docs/reference/settings.md lists all.
"""

import dataclasses
import os
from collections.abc import Iterator
from ipaddress import ip_network
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, SecretStr
from pydantic_settings import (
    BaseSettings,
    PydanticBaseSettingsSource,
    SecretsSettingsSource,
    SettingsConfigDict,
    SettingsError,
)

from service.api.access.auth import origins_of
from service.api.limits.rate_limits import RateLimitConfig
from service.pipeline import config
from service.pipeline.control.release.interlock_conditions import ReleaseSettings
from service.records.setting import CHOSEN, SettingEntry, SettingSource
from service.records.storage import RetentionConfig, SealingConfig
from service.runtime.jobs.job_runner import WorkerConfig
from service.runtime.jobs.smoothing import SmoothingConfig


def _networks(value: str | None) -> str | None:
    """Return the text unless one of its parts is no address; `*` is none: it would let every client invent its own."""
    for part in (value or "").split(","):
        if part.strip():
            ip_network(part.strip(), strict=False)
    return value


def _origins(value: str | None) -> str | None:
    """Return the text unless one of its parts is no origin; `*` is none: every page could read what a key may."""
    origins_of(value)
    return value


TrustedProxies = Annotated[str | None, AfterValidator(_networks)]
AllowedOrigins = Annotated[str | None, AfterValidator(_origins)]


class Settings(BaseSettings):
    """Settings of the service, from environment variables."""

    model_config = SettingsConfigDict(
        env_prefix="SOO_",
        env_nested_delimiter="__",
        # an empty variable, as compose files pass on unset ones, counts as not set: no empty administrator key
        env_ignore_empty=True,
        extra="ignore",
        frozen=True,
        arbitrary_types_allowed=False,
    )

    @classmethod
    def settings_customise_sources(
        cls, settings_cls: type[BaseSettings], *sources: PydanticBaseSettingsSource, **named: PydanticBaseSettingsSource
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Return where settings come from: arguments, environment, then a folder with a file a setting."""
        given = (*sources, *named.values())[:2]
        folder = os.environ.get("SOO_SECRETS_DIR")
        if not folder:
            return given
        if not Path(folder).is_dir():
            message = f"SOO_SECRETS_DIR: there is no folder {folder}"
            raise SettingsError(message)
        return (*given, SecretsSettingsSource(settings_cls, folder))

    database_url: str = Field("sqlite:///soo.db", description="SQLAlchemy URL of the archive")
    database_timeout_s: float = Field(
        10.0, gt=0, description="a lock, or an answer of the database, is waited for so long; then 503, s"
    )
    bootstrap_key: SecretStr | None = Field(
        None,
        description="administrator's bearer key, accepted while set; without it the first start writes one into a file",
    )
    estimator: bool = Field(
        True, description="whether this process estimates its share of the spacecraft; others store rows and answer"
    )
    clock: Literal["system", "data"] = Field(
        "system", description="`data` lets accepted epochs move the clock of simulated spacecraft"
    )
    host: str = Field("127.0.0.1", description="address to listen on")
    port: int = Field(8000, ge=0, le=65535, description="port to listen on; 0 takes a free one and prints it")
    log_level: Literal["debug", "info", "warning", "error"] = Field("info", description="least severe log line kept")
    tls_certificate: str | None = Field(None, description="file of the certificate chain, PEM; with it HTTPS is served")
    tls_key: str | None = Field(None, description="file of the certificate's private key, PEM")
    trusted_proxies: TrustedProxies = Field(
        None, description="addresses or networks, by commas, whose X-Forwarded-For and -Proto are believed"
    )
    plain_sessions: bool = Field(
        False, description="whether browsers on other machines may send a key without TLS to open a session"
    )
    allowed_origins: AllowedOrigins = Field(
        None, description="origins, by commas, whose pages may read (GET, HEAD) with a bearer key; none by default"
    )
    request_timeout_s: float = Field(60.0, gt=0, description="a request must be complete within this, s")
    rate_limit: RateLimitConfig = Field(RateLimitConfig(), description="requests by key and class")
    log_format: Literal["json", "text"] = Field(
        "json", description="`json` writes one object a line, `text` lines for people"
    )
    access_log: bool = Field(True, description="whether a line is written of every request")
    metrics_need_key: bool = Field(False, description="whether /metrics is given to holders of a key only")
    ready_lag: int = Field(
        1000, ge=0, description="entries by which the estimator may lie behind its journal and /readyz yet say ready"
    )
    min_free_disk_bytes: int = Field(
        200_000_000, ge=0, description="free space beside the database below which /readyz says not ready, bytes"
    )
    max_streams: int = Field(500, ge=1, description="live streams at once")
    max_sources_per_key: int = Field(500, ge=1, description="sources that a station or a person's key may make")
    max_connections: int = Field(2000, ge=1, description="connections at once; fewer where descriptors are short")
    max_connections_per_address: int = Field(
        64, ge=1, description="connections of one address at once (IPv6: of its /64); trusted proxies are exempt"
    )
    future_tolerance_s: float = Field(5.0, ge=0, description="how far ahead of the system clock an epoch may lie, s")
    future_tolerance_data_s: float = Field(
        2_592_000.0, ge=0, le=31_622_400, description="how far ahead of the data clock an epoch may lie, s"
    )
    late_after_s: float = Field(300.0, ge=0, description="age from which a row counts as late, system clock, s")
    max_body_bytes: int = Field(8_388_608, ge=1024, description="greatest request body after unpacking, bytes")
    max_rows_per_batch: int = Field(10_000, ge=1, description="most rows of one batch")
    evidence_traces: int = Field(2880, ge=0, description="evidence traces kept of one source; 0 keeps none")
    evidence_bytes: int = Field(67_108_864, ge=0, description="bytes that the points of those traces may take")
    alarm_notices_from: Literal["watch", "warning", "distress", "critical", "severe"] = Field(
        "warning", description="least severity of alarms that are told by webhook and mail"
    )
    alarm_webhook_url: SecretStr | None = Field(None, description="where notices of alarms are POSTed to as JSON")
    alarm_webhook_secret: SecretStr | None = Field(None, description="shared with the receiver, signs the notices")
    alarm_mail_host: str | None = Field(None, description="mail server that takes notices of alarms")
    alarm_mail_port: int = Field(587, ge=1, le=65535, description="its port")
    alarm_mail_security: Literal["starttls", "tls", "none"] = Field("starttls", description="how the line is secured")
    alarm_mail_user: str | None = Field(None, description="user at the mail server; without one nobody logs in")
    alarm_mail_password: SecretStr | None = Field(None, description="that user's password")
    alarm_mail_from: str = Field("soo@localhost", description="sender of notices")
    alarm_mail_to: str | None = Field(None, description="receivers of notices, by commas")
    workers: WorkerConfig = Field(WorkerConfig(), description="calibrations in worker processes")
    calibration: config.CalibrationConfig = Field(config.CalibrationConfig(), description="calibration jobs")
    alignment: config.AlignmentConfig = Field(config.AlignmentConfig(), description="alignments")
    estimation: config.EstimationConfig = Field(config.EstimationConfig(), description="the paper method in operation")
    fade: config.FadeConfig = Field(config.FadeConfig(), description="downlink rain rule")
    interlock: config.InterlockConfig = Field(config.InterlockConfig(), description="what inhibits control")
    torque: config.TorqueConfig = Field(config.TorqueConfig(), description="torque pulses")
    release: ReleaseSettings = Field(ReleaseSettings(), description="release of torques")
    robust: config.RobustConfig = Field(config.RobustConfig(), description="the robust method in operation")
    operations: config.OperationConfig = Field(
        config.OperationConfig(), description="what declared operations mean to it"
    )
    smoothing: SmoothingConfig = Field(SmoothingConfig(), description="live series of smoothed angles")

    alarms: config.AlarmConfig = Field(config.AlarmConfig(), description="alarms by default")
    sealing: SealingConfig = Field(SealingConfig(), description="packing of closed days")
    retention: RetentionConfig = Field(RetentionConfig(), description="how long series are kept")

    def chain_config(self) -> config.ChainConfig:
        """Return the configuration of every chain."""
        return config.ChainConfig(
            self.estimation,
            self.fade,
            self.interlock,
            self.torque,
            self.robust,
            self.operations,
        )


def setting_entries(settings: Settings) -> Iterator[SettingEntry]:
    """Yield every setting in the order of its declaration, with the value that some settings give it."""
    for name, field in Settings.model_fields.items():
        value = getattr(settings, name)
        if dataclasses.is_dataclass(value):
            yield from _stage_entries(name, field.default, value)
        else:
            meaning = field.description or ""
            yield SettingEntry(_variable(name), _shown(field.default), meaning, CHOSEN, _shown(value))


def entries_in_force(settings: Settings) -> tuple[SettingEntry, ...]:
    """Return every setting with where its value was read; one that neither variable nor file gives is an option's."""
    read = {entry.name: entry.value for entry in setting_entries(Settings.model_validate({}))}
    variables = {variable.upper() for variable, value in os.environ.items() if value}
    folder = os.environ.get("SOO_SECRETS_DIR")
    files = {path.name.upper() for path in Path(folder).iterdir()} if folder else set()
    return tuple(
        entry._replace(source=_source(entry.name, variables, files) if entry.value == read[entry.name] else "option")
        for entry in setting_entries(settings)
    )


def _source(name: str, variables: set[str], files: set[str]) -> SettingSource:
    """Return where a setting is read when no option gives it."""
    # a whole stage may stand in one variable, as JSON
    names = {name, name.partition("__")[0]}
    if names & variables:
        return "environment"
    return "file" if names & files else "default"


def _stage_entries(path: str, default: Any, value: Any) -> Iterator[SettingEntry]:
    """Yield the settings of a stage's configuration at every depth."""
    for field in dataclasses.fields(value):
        inner = f"{path}.{field.name}"
        inner_default, inner_value = getattr(default, field.name), getattr(value, field.name)
        if dataclasses.is_dataclass(inner_value):
            yield from _stage_entries(inner, inner_default, inner_value)
        else:
            said = field.metadata
            shown = _shown(inner_default), said["meaning"], said["origin"], _shown(inner_value)
            yield SettingEntry(_variable(inner), *shown)


def _variable(path: str) -> str:
    return "SOO_" + path.replace(".", "__").upper()


def _shown(value: object) -> str:
    """Return a value as it is printed; a secret only says that it is set."""
    if isinstance(value, SecretStr):
        return "(set)"
    return "none" if value is None else _without_password(str(value))


def _without_password(text: str) -> str:
    """Return a text as it is, a URL without user, password and parameters, any of which may hold a secret."""
    scheme, mark, rest = text.partition("://")
    # a password may hold any sign: only what follows the last @ is shown
    _, at, shown = rest.rpartition("@")
    shown, has_parameters, _ = shown.partition("?")
    return f"{scheme}{mark}{'***@' if at else ''}{shown}{'?***' if has_parameters else ''}" if mark else text
