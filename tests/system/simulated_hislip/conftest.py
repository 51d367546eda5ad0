"""An analyzer over HiSLIP and a client of bytes for it."""

from collections.abc import Iterator

import pytest
from analyzer_thread import AnalyzerThread, start_in_thread
from hislip_client import (
    Client,
    Held,
)


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
