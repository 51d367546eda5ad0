"""The journal of one world, written as a control centre would fill it.

Corrections stand where they are announced, plans, ephemerides, operations and telemetry where the ground learns of
them, each before the first row that is not older.
"""

from collections.abc import Iterator
from typing import NamedTuple

from service.pipeline.chain import Chain
from service.pipeline.inputs.knowledge import JournalDocuments
from service.records.catalogue import CarrierPlan, Ephemeris
from service.records.inputs import PlanChange, SourceSelection
from service.records.journal import SlowInput
from service.records.levels.attitude import IntArray
from service.records.levels.measurement import Measurement
from service.study.estimation.flight.world import Ground


class Entry(NamedTuple):
    """A slow input and when the ground hands it over."""

    epoch_us: int
    content: SlowInput


def slow_entries(ground: Ground, documents: JournalDocuments) -> list[Entry]:
    """Return the slow inputs in the order in which the ground hands them over."""
    entries = []
    for reported_us, content in ground.events:
        if isinstance(content, tuple):
            entries.append(Entry(reported_us, documents.add_plan(content)))
        elif isinstance(content, Ephemeris):
            entries.append(Entry(reported_us, documents.add_ephemeris(content)))
        else:
            entries.append(Entry(reported_us, content))
    return sorted(entries, key=lambda entry: entry.epoch_us)


def measurements(
    chain: Chain, ground: Ground, documents: JournalDocuments, entries: list[Entry], rows: IntArray
) -> Iterator[Measurement]:
    """Yield the measurements in order, teaching the chain what comes before each of them."""
    waiting = entries[::-1]
    later = [entry.content.plan_id for entry in entries if isinstance(entry.content, PlanChange)]
    plan_id, prime = min(later, default=len(documents.plans) + 1) - 1, ground.source_names[0]
    columns = _columns(ground, documents.plans[plan_id])
    for number, row in enumerate(rows.tolist(), start=1):
        epoch_us, source = int(ground.epochs_us[row]), ground.source_names[ground.source[row]]
        while waiting and waiting[-1].epoch_us <= epoch_us:
            content = waiting.pop().content
            chain.update(content)
            if isinstance(content, PlanChange):
                plan_id, columns = content.plan_id, _columns(ground, documents.plans[content.plan_id])
            elif isinstance(content, SourceSelection):
                prime = content.source
        power_dbm = ground.power_dbm[row, columns]
        yield Measurement(epoch_us, epoch_us, number, source, plan_id, power_dbm, None, feeds_estimator=source == prime)


def _columns(ground: Ground, plan: CarrierPlan) -> list[int]:
    """Return the columns of the world in the order of a plan."""
    return [ground.carrier_ids.index(name) for name in plan.carrier_ids]
