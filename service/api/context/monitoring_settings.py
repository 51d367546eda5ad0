"""Settings of monitoring: criteria of readiness, access to metrics, log of requests."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitoringSettings:
    """Settings of readiness, metrics and access log."""

    #: whether /metrics wants a key
    metrics_need_key: bool = False
    #: whether a line is written of every request
    access_log: bool = True
    #: entries by which the estimator may lie behind the journal and yet be ready
    ready_lag: int = 1000
    #: free space beside the database below which the service is not ready
    min_free_disk_bytes: int = 200_000_000
