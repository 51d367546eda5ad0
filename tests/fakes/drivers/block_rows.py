"""Rows of a block one by one."""

from service.records.levels.measurement import MeasurementBlock


def row_sources(block: MeasurementBlock) -> list[str]:
    """Return the source of each row."""
    if block.source_positions is None:
        return [block.sources[0]] * len(block.epochs_us)
    return [block.sources[position] for position in block.source_positions.tolist()]
