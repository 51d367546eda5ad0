"""An analyzer over HiSLIP and a client of bytes for it."""

from collections.abc import Iterator

import pytest
from hislip_client import (
    Client,
    Held,
)

from analyzer_sim.lines.server import AnalyzerThread, start_in_thread


@pytest.fixture
def held() -> Held:
    return Held()


@pytest.fixture
def analyzer(held: Held) -> Iterator[AnalyzerThread]:
    with start_in_thread(held.instrument, hislip_port=0) as handle:
        yield handle


@pytest.fixture
def client(analyzer: AnalyzerThread) -> Iterator[Client]:
    with Client(analyzer.hislip_port) as made:
        yield made
