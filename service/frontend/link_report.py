"""Reports of the links to the service, and what operators want of them: rest, go on, begin again.

Law of this file: it never disturbs the measuring. A service that is away, refuses the report or answers nonsense
changes nothing; the next report says the same or newer.
"""

import logging
import threading
from collections.abc import Sequence
from typing import Any

from service.client.problem import ClientError
from service.client.service_client import ServiceClient
from service.frontend.station import MeasuringStation
from service.records.epoch import format_epoch
from service.records.operations.work import STOPPED

logger = logging.getLogger("service.frontend.link_report")

#: time between reports, s
REPORT_PERIOD_S = 5.0
#: states of a front end as a whole
RUNNING, SERVICE_AWAY = "RUNNING", "SERVICE_AWAY"


class LinkReporter:
    """Reports all analyzers of a front end, and the front end itself.

    Parameters
    ----------
    client : ServiceClient
        Without retries of its own.
    name : str
        Name of the front end among links.
    stations : sequence of Station
        What it measures.
    period_s : float
        Time between reports.
    """

    def __init__(
        self, client: ServiceClient, name: str, stations: Sequence[MeasuringStation], period_s: float = REPORT_PERIOD_S
    ) -> None:
        self._client = client
        self._name = name
        self._stations = {station.link_id: station for station in stations}
        self._period_s = period_s
        self._resets_seen: int | None = None
        self._is_ending = False
        self._is_away = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self.run, name="link reports", daemon=True)

    def start(self) -> None:
        """Report from a thread of its own."""
        self._thread.start()

    def stop(self) -> None:
        """End the reports with a last one."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(2.0 * self._period_s)

    def run(self) -> None:
        """Report until the stop."""
        while not self._stop.wait(self._period_s):
            self.report()
        self._is_ending = True
        self.report()

    def report(self) -> None:
        """Report once and obey the answer."""
        try:
            requests = self._client.report_links(self.links())
            for request in requests:
                self._apply(str(request["id"]), is_enabled=bool(request["enabled"]), resets=int(request["reset"]))
        except (ClientError, LookupError, TypeError, ValueError) as error:
            if not self._is_away:
                logger.warning("link reports cannot be sent, will retry: %s", error)
            self._is_away = True
        else:
            if self._is_away:
                logger.info("link reports are sent again")
            self._is_away = False

    def links(self) -> list[dict[str, Any]]:
        """Return the report."""
        links = [self._front_end(), *(analyzer_link(station, self._period_s) for station in self._stations.values())]
        return [{**link, "state": STOPPED} for link in links] if self._is_ending else links

    def _front_end(self) -> dict[str, Any]:
        """Return the report of the front end itself."""
        stations = list(self._stations.values())
        goods = [each.uploader.counters.last_good_us for each in stations]
        newest_us = max((each for each in goods if each is not None), default=None)
        is_down = any(station.uploader.is_down for station in stations)
        return {
            "id": self._name,
            "kind": "front_end",
            "state": SERVICE_AWAY if is_down else RUNNING,
            "detail": {"analyzers": list(self._stations)[:100]},
            "counters": {
                "analyzers": len(stations),
                "rows": sum(station.acquisition.counters.rows for station in stations),
                "accepted": sum(station.uploader.counters.accepted for station in stations),
                "waiting": sum(station.spool.waiting for station in stations),
            },
            "last_good": None if newest_us is None else format_epoch(newest_us),
            "warnings": [],
            "reset_seen": self._resets_seen or 0,
            "period_s": self._period_s,
        }

    def _apply(self, link_id: str, *, is_enabled: bool, resets: int) -> None:
        """Do with one link what is wanted; a reset of the front end is one of all its analyzers."""
        station = self._stations.get(link_id)
        if station is not None:
            station.acquisition.orders.apply(is_enabled=is_enabled, resets=resets)
        elif link_id == self._name:
            if self._resets_seen is not None and resets > self._resets_seen:
                for each in self._stations.values():
                    each.acquisition.orders.reset()
            self._resets_seen = resets


def analyzer_link(station: MeasuringStation, period_s: float) -> dict[str, Any]:
    """Return the report of one analyzer's link."""
    acquisition, counters, spool = station.acquisition, station.acquisition.counters, station.spool.state
    upload = station.uploader.counters
    warnings = [*station.spool.warnings, *([upload.not_accepted] if upload.not_accepted else ())]
    return {
        "id": station.link_id,
        "kind": "analyzer",
        "spacecraft_id": station.upload.spacecraft_id,
        "source": station.upload.source,
        "state": "STUCK" if acquisition.is_stuck else counters.state.name,
        "detail": {
            "resource": station.resource,
            "analyzer": acquisition.identity[:200],
            "task": station.task.task.id,
            "period_s": acquisition.period_s,
            "last_fault": counters.last_fault[:500],
            "last_failure": upload.last_failure[:500],
        },
        "counters": counters.as_json()
        | {
            "accepted": upload.accepted,
            "duplicates": upload.duplicates,
            "late": upload.late,
            "refused": upload.refused,
            "failures": upload.failures,
            "waiting": spool.waiting,
            "last_seq": spool.last_seq,
            "traces_waiting": spool.traces_waiting,
        }
        | {f"dropped_{reason}": rows for reason, rows in spool.dropped.items()},
        "last_good": None if counters.last_good_us is None else format_epoch(counters.last_good_us),
        "warnings": [*acquisition.warnings, *(each.as_json() for each in warnings)],
        "reset_seen": acquisition.orders.resets_seen,
        "period_s": period_s,
    }
