"""Every rule runs in every dialect; a dialect without facts fails, so that none comes in unjudged."""

from collections.abc import Callable

import pytest
from dialect_facts import FACTS, Facts
from scpi_bench import Bench

from analyzer_sim.dialects.dialects import DIALECTS


@pytest.fixture(params=sorted(DIALECTS))
def name(request: pytest.FixtureRequest) -> str:
    """Name of a dialect."""
    return str(request.param)


@pytest.fixture
def facts(name: str) -> Facts:
    """What the specification says of the dialect."""
    return FACTS[name]


@pytest.fixture
def make_bench(name: str) -> Callable[..., Bench]:
    """Benches of the dialect."""
    return lambda **options: Bench(name, **options)


@pytest.fixture
def bench(name: str) -> Bench:
    """An instrument of the dialect with its first session."""
    return Bench(name)
