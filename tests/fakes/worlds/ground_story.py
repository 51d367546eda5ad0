"""Lines of a world without the holds of the ground port."""

from collections.abc import Iterator

from analyzer_sim.world.ground.ground import ROWS_PER_CHUNK, Line, catalogue_lines, chunk_lines, chunks_of
from analyzer_sim.world.world import World


def ground_lines(world: World, rows_per_chunk: int = ROWS_PER_CHUNK) -> Iterator[Line]:
    """Yield all lines of a world in the order in which the ground port sends them, holds left out."""
    yield from catalogue_lines(world)
    for first, last, _phase in chunks_of(world, rows_per_chunk):
        yield from chunk_lines(world, first, last)
