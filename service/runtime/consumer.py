"""Consumption of a journal: the one way in which live operation and replay feed the chain.

An alignment entry makes the chain run the rows already stored after its epoch, in order of epoch; every other entry is
one call. Because both run this very code on the same stored values, a replay equals the live run bit for bit.
"""

import logging
from collections.abc import Iterator

from service.pipeline.chain import Chain
from service.ports import Archive, Catalogue, Outcome, Results
from service.records.attitude import row_without_attitude
from service.records.calibration import Alignment, Calibration
from service.records.catalogue import CarrierPlan, Ephemeris, Method
from service.records.inputs import AlignmentSet
from service.records.journal import JournalEntry
from service.records.measurement import Measurement

_LOG = logging.getLogger("soo.consumer")

#: kinds of slow input that the chain must know from before an alignment; the others concern rows after it
STANDING_KINDS = ("spacecraft", "plan", "ephemeris", "activation", "operation")


class Documents:
    """Immutable documents of one spacecraft by number, each read once."""

    def __init__(self, catalogue: Catalogue, results: Results, spacecraft_id: str) -> None:
        self._catalogue = catalogue
        self._results = results
        self._spacecraft_id = spacecraft_id
        self._plans: dict[int, CarrierPlan] = {}
        self._ephemerides: dict[int, Ephemeris] = {}
        self._calibrations: dict[int, Calibration] = {}
        self._alignments: dict[int, Alignment] = {}

    def plan(self, plan_id: int) -> CarrierPlan:
        """Return a carrier plan."""
        if plan_id not in self._plans:
            self._plans[plan_id] = self._catalogue.plan(self._spacecraft_id, plan_id)
        return self._plans[plan_id]

    def ephemeris(self, ephemeris_id: int) -> Ephemeris:
        """Return an ephemeris."""
        if ephemeris_id not in self._ephemerides:
            self._ephemerides[ephemeris_id] = self._catalogue.ephemeris(self._spacecraft_id, ephemeris_id)
        return self._ephemerides[ephemeris_id]

    def calibration(self, calibration_id: int) -> Calibration:
        """Return a calibration that has its result."""
        if calibration_id not in self._calibrations:
            self._calibrations[calibration_id] = self._results.calibration(self._spacecraft_id, calibration_id)
        return self._calibrations[calibration_id]

    def alignment(self, alignment_id: int) -> Alignment:
        """Return an alignment."""
        if alignment_id not in self._alignments:
            self._alignments[alignment_id] = self._results.alignment(self._spacecraft_id, alignment_id)
        return self._alignments[alignment_id]


def consume(chain: Chain, entry: JournalEntry, archive: Archive, spacecraft_id: str) -> Iterator[Outcome]:
    """Feed one entry to the chain and yield what came of each row."""
    content = entry.content
    if isinstance(content, Measurement):
        yield from _step(chain, content, is_catch_up=False)
        return
    chain.learn(content)
    if isinstance(content, AlignmentSet) and chain.knowledge.alignment is not None:
        after_us = chain.knowledge.alignment.epoch_us
        for measurement in archive.measurements_after(spacecraft_id, after_us, entry.number):
            yield from _step(chain, measurement, is_catch_up=True)


def _step(chain: Chain, measurement: Measurement, *, is_catch_up: bool) -> Iterator[Outcome]:
    """Feed one row; numbers that break the computation make a row that says so, and the stream goes on."""
    try:
        outcome = chain.step(measurement, is_catch_up=is_catch_up)
    except (ArithmeticError, ValueError):
        _LOG.exception("computing the row at journal number %d failed", measurement.number)
        number, epoch_us, received_us = measurement.number, measurement.epoch_us, measurement.received_at_us
        row = row_without_attitude(epoch_us, received_us, number, Method.PAPER, ("internal_error",))
        outcome = Outcome((row,), None)
    if outcome is not None:
        yield outcome


def prepare(chain: Chain, archive: Archive, spacecraft_id: str, before_number: int) -> None:
    """Tell the chain all standing slow inputs from before a journal number."""
    for entry in archive.slow_inputs_before(spacecraft_id, before_number, STANDING_KINDS):
        if not isinstance(entry.content, Measurement):
            chain.learn(entry.content)
