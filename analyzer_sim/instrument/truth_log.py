"""The simulator's truth as JSON lines: which row every sweep showed, and which traces left whole. For tests alone.

One object a line, written and flushed at once; a client never sees this file. First a line of kind ``world``, then::

    {"kind": "sweep", "sweep": 7, "row": 6, "epoch": "2026-11-01T00:06:00Z", "power_dbm": {"c01": -43.1, "c02": null},
     "interference_dbm": {}, "settings": "9f0c...", "start_hz": ..., "stop_hz": ..., "points": ..., "sweep_time_s": ...}
    {"kind": "trace", "sweep": 7, "row": 6, "epoch": "2026-11-01T00:06:00Z", "session": "socket 1", "spoiled": false}

* ``sweep`` counts completed sweeps from 1, ``row`` is the index of the world's row; several sweeps may show one row
  (``INIT:CONT ON``).
* ``power_dbm`` is each carrier's own power at the analyzer input, null while it is off; lines that interfere stand
  apart, under the name of their carrier.
* ``settings`` is a digest: equal when all settings are.
* A trace is written when the operating system has taken the last byte of its answer; an answer that a fault of the line
  touched is not. ``spoiled`` tells that its numbers were wrong on purpose.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TextIO

from analyzer_sim.emission import Emission
from analyzer_sim.epochs import rfc3339
from analyzer_sim.instrument.instrument_settings import Settings

_INTERFERENCE = "interference "
_DIGEST_CHARACTERS = 16
#: newest sweeps whose rows are remembered for traces that leave late
_REMEMBERED_SWEEPS = 1000


class Reading(NamedTuple):
    """A trace that an answer contains."""

    #: number of the sweep it shows
    sweep: int
    is_spoiled: bool


class TruthLog:
    """Writes the truth of one run.

    Parameters
    ----------
    stream : TextIO
        Where lines go.
    carriers : sequence of str
        Names of all carriers, in the order of the plan.
    row_of : callable
        Index of the world's present row.
    """

    def __init__(self, stream: TextIO, carriers: Sequence[str], row_of: Callable[[], int]) -> None:
        self._stream = stream
        self._carriers = tuple(carriers)
        self._row_of = row_of
        self._shown: dict[int, dict[str, Any]] = {}

    def begin(self, scenario: str, seed: int) -> None:
        """Write which world this is."""
        self._write({"kind": "world", "scenario": scenario, "seed": seed, "carriers": list(self._carriers)})

    def sweep(self, number: int, emission: Emission, settings: Settings) -> None:
        """Write a completed sweep."""
        position = {"sweep": number, "row": self._row_of(), "epoch": rfc3339(emission.epoch_us)}
        self._shown[number] = position
        self._shown.pop(number - _REMEMBERED_SWEEPS, None)
        powers_dbm = {signal.carrier: round(signal.power_dbm, 6) for signal in emission.signals}
        self._write(
            {
                "kind": "sweep",
                **position,
                "power_dbm": {carrier: powers_dbm.get(carrier) for carrier in self._carriers},
                "interference_dbm": {
                    name.removeprefix(_INTERFERENCE): power
                    for name, power in powers_dbm.items()
                    if name.startswith(_INTERFERENCE)
                },
                "settings": hashlib.sha256(repr(settings).encode()).hexdigest()[:_DIGEST_CHARACTERS],
                "start_hz": settings.start_hz,
                "stop_hz": settings.stop_hz,
                "points": settings.points,
                "sweep_time_s": settings.time_s,
            }
        )

    def trace(self, reading: Reading, session: str) -> None:
        """Write a trace that left whole."""
        position = self._shown.get(reading.sweep, {"sweep": reading.sweep})
        self._write({"kind": "trace", **position, "session": session, "spoiled": reading.is_spoiled})

    def _write(self, line: dict[str, Any]) -> None:
        self._stream.write(json.dumps(line, allow_nan=False, separators=(",", ":")) + "\n")
        self._stream.flush()
