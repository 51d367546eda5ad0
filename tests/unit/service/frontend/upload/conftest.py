"""A spool for uploads."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from spooled_rows import spool

from service.frontend.spool.spool import Spool


@pytest.fixture
def rows(tmp_path: Path) -> Iterator[Spool]:
    """Give a spool that keeps every trace."""
    with spool(tmp_path, trace_period_s=0.0) as made:
        yield made
