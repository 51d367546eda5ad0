"""Rows of a block one by one."""

from service.records.levels.measurement_block import MeasurementBlock


def row_sources(block: MeasurementBlock) -> list[str]:
    """Return the source of each row."""
    if block.source_places is None:
        return [block.sources[0]] * len(block.epochs_us)
    return [block.sources[place] for place in block.source_places.tolist()]
