"""Instruments on a world that stands still, and lines to them, without a socket."""

from collections.abc import Callable
from typing import Any

import pytest
from scpi_bench import Bench


@pytest.fixture
def bench() -> Bench:
    return Bench("rs")


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    def make(dialect: str = "rs", **options: Any) -> Bench:
        return Bench(dialect, **options)

    return make
