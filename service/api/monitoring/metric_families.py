"""Metrics by name: what each tells, in which unit, by which labels. The dashboard and the alert rules use these names.

Every label has a bound: axes, methods, states and codes are words of the service; of spacecraft, sources, carriers and
links no more than the limits below are told, in order of their ids.
"""

from typing import Literal, NamedTuple

#: things of each kind that are told at most
MAX_SPACECRAFT = 50
MAX_SOURCES = 20
MAX_CARRIERS = 128
MAX_LINKS = 200

#: what a status is told as: the four states of the mission-control world
STATUS_NUMBERS = {"NOT_RECEIVED": 0, "ACQUIRED": 1, "INVALID": 2, "EXPIRED": 3}


class Family(NamedTuple):
    """One metric."""

    kind: Literal["gauge", "counter", "histogram"]
    help: str
    labels: tuple[str, ...] = ()


_STATES = "0 not received, 1 acquired, 2 invalid, 3 expired"

FAMILIES: dict[str, Family] = {
    # the spacecraft
    "soo_sample_age_seconds": Family(
        "gauge", "age of the newest measurement of a source, by the spacecraft's clock", ("spacecraft", "source")
    ),
    "soo_series_status": Family("gauge", f"newest power of a carrier: {_STATES}", ("spacecraft", "carrier")),
    "soo_attitude_deg": Family(
        "gauge", "newest attitude, degrees; absent while there is none", ("spacecraft", "method", "axis")
    ),
    "soo_attitude_sigma_deg": Family(
        "gauge", "one standard deviation of the newest attitude, degrees", ("spacecraft", "method", "axis")
    ),
    "soo_attitude_status": Family("gauge", f"newest attitude: {_STATES}", ("spacecraft", "method")),
    "soo_control_allowed": Family(
        "gauge", "1 when a torque may go now: neither interlock nor newest attitude forbids it", ("spacecraft",)
    ),
    "soo_journal_lag": Family(
        "gauge", "entries of the journal that the estimator has not consumed yet", ("spacecraft",)
    ),
    "soo_smoothed_lag_seconds": Family(
        "gauge", "newest consumed row less newest smoothed row of the live series, by epochs", ("spacecraft",)
    ),
    "soo_filter_rows_total": Family(
        "counter",
        "rows of the robust method since its chain began, by kind: ordinary, or event (something found or declared)",
        ("spacecraft", "kind"),
    ),
    # rows on their way in
    "soo_rows_total": Family(
        "counter", "rows received, by outcome: accepted, duplicates, late (accepted too)", ("spacecraft", "outcome")
    ),
    "soo_rows_refused_total": Family("counter", "rows refused, by code", ("spacecraft", "code")),
    "soo_rows_missing": Family(
        "gauge", "rows that the numbers of a source count and the archive does not hold", ("spacecraft", "source")
    ),
    "soo_link_state": Family("gauge", "1 for the present state of a link", ("link", "state")),
    "soo_link_last_good_age_seconds": Family("gauge", "age of the newest good row of a link", ("link",)),
    # the interface
    "soo_http_requests_total": Family("counter", "requests answered", ("method", "route", "status")),
    "soo_http_request_duration_seconds": Family(
        "histogram", "time from the request to the end of its answer, streams left out", ("route",)
    ),
    "soo_http_requests_in_progress": Family("gauge", "requests being answered, open streams among them"),
    "soo_connections": Family("gauge", "connections that are open"),
    "soo_connections_refused_total": Family(
        "counter",
        "connections refused (address, total: too many) or ended (slow: no whole request in time)",
        ("reason",),
    ),
    "soo_stream_clients": Family("gauge", "live streams that are open"),
    "soo_stream_events_total": Family("counter", "events sent to clients of live streams", ("kind",)),
    "soo_stream_dropped_total": Family("counter", "events that clients were too slow for; they follow from history"),
    # the service
    "soo_ready": Family("gauge", "1 when a part of the service is ready; /readyz says why not", ("part",)),
    "soo_writer_queue": Family("gauge", "writes that wait for the database's writer"),
    "soo_disk_free_bytes": Family("gauge", "free space beside the database; absent where it is on another machine"),
    "soo_process_resident_memory_bytes": Family("gauge", "memory in use"),
    "soo_process_cpu_seconds_total": Family("counter", "processor time used"),
    "soo_process_open_files": Family("gauge", "files and sockets open"),
    "soo_process_threads": Family("gauge", "threads"),
    "soo_build_info": Family("gauge", "always 1; the version stands in its label", ("version",)),
}
