"""Evidence traces to the service, when no row waits: kept until they are accounted for, given up before they block.

A service that does not know traces (404) is left alone for a while; a trace that it cannot read is given up, counted
and logged, for evidence must not stand in the way of measurements.
"""

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.client.problem import ProblemError, ServiceUnavailableError
from service.client.service_client import ServiceClient
from service.frontend.spool.row import SpooledTrace
from service.frontend.spool.spool import Spool
from service.records.epoch import format_epoch

logger = logging.getLogger("service.frontend.upload.uploader")

#: a service that did not know traces is asked again after this time, s
_AGAIN_S = 600.0
#: decimals of a point on the wire, dB
_DECIMALS = 2
_UNKNOWN, _TOO_LARGE, _UNREADABLE = 404, 413, 422


@dataclass(slots=True)
class TraceCounters:
    """Counters of the traces."""

    sent: int = 0
    #: given up because the service rejected their content or their epochs
    refused: int = 0


class TraceSender:
    """Send traces of a spool.

    Parameters
    ----------
    client : ServiceClient
        Without retries of its own.
    spacecraft_id, source : str
        Destination.
    spool : Spool
        Where the traces wait.
    batch : int
        Traces of one request at most.
    elapsed_s : callable
        Clock that only runs forward, s.
    """

    def __init__(
        self,
        client: ServiceClient,
        spacecraft_id: str,
        source: str,
        spool: Spool,
        batch: int,
        elapsed_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.counters = TraceCounters()
        self._client = client
        self._spacecraft_id = spacecraft_id
        self._source = source
        self._spool = spool
        self._batch = batch
        self._elapsed_s = elapsed_s
        self._from_s = float("-inf")

    def is_due(self) -> bool:
        """Return whether a trace waits and the service may accept it."""
        return self._spool.traces_waiting > 0 and self._elapsed_s() >= self._from_s

    def patience_s(self) -> float:
        """Return how long a wait for rows may be before traces are due, s."""
        return max(self._from_s - self._elapsed_s(), 0.0) if self._spool.traces_waiting else float("inf")

    def send(self) -> None:
        """Send the oldest traces once.

        Raises
        ------
        ServiceUnavailableError
            No answer, or one that does not account for the traces: they are to be sent again.
        ProblemError
            A refusal that has nothing to do with the traces, for example of the key.
        """
        traces = self._spool.traces(self._batch)
        if not traces:
            return
        try:
            reply = self._client.post_traces(self._spacecraft_id, self._source, [_as_json(each) for each in traces])
        except ProblemError as problem:
            self._face(problem, traces)
            return
        if not _accounts_for(reply, len(traces)):
            message = f"answer does not account for {len(traces)} traces: {str(reply)[:200]}"
            raise ServiceUnavailableError(message)
        refused = len(reply.get("refused", ()))
        self.counters.sent += len(traces) - refused
        self.counters.refused += refused
        self._spool.settle_traces(traces)

    def _face(self, problem: ProblemError, traces: list[SpooledTrace]) -> None:
        """Act on traces that were refused as a whole."""
        if problem.status == _UNKNOWN:
            self._from_s = self._elapsed_s() + _AGAIN_S
            logger.info("the service does not accept traces (%s); next attempt in %.0f s", problem, _AGAIN_S)
        elif problem.status in {_TOO_LARGE, _UNREADABLE} and len(traces) > 1:
            self._batch = 1  # which one it is shows when they go alone
        elif problem.status in {_TOO_LARGE, _UNREADABLE}:
            self.counters.refused += 1
            logger.error(
                "trace of %s is dropped, the service rejects it: %s", format_epoch(traces[0].epoch_us), problem
            )
            self._spool.settle_traces(traces)
        else:
            raise problem


def _as_json(trace: SpooledTrace) -> dict[str, Any]:
    """Return a trace as the contract has it."""
    levels = np.round(np.frombuffer(trace.power_dbm, dtype="<f4").astype(np.float64), _DECIMALS).tolist()
    return {
        "epoch": format_epoch(trace.epoch_us),
        "sweep": trace.sweep,
        "start_hz": trace.start_hz,
        "step_hz": trace.step_hz,
        "rbw_hz": trace.rbw_hz,
        "enbw_hz": trace.enbw_hz,
        "sweep_time_s": trace.sweep_time_s,
        "power_dbm": [level if math.isfinite(level) else None for level in levels],
    }


def _accounts_for(reply: Any, traces: int) -> bool:
    """Return whether an answer accounts for every trace."""
    try:
        return int(reply["accepted"]) + int(reply["duplicates"]) + len(reply.get("refused", ())) == traces
    except (KeyError, TypeError, ValueError):
        return False
