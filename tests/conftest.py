"""Fixtures that several trees of tests share; the makers themselves lie in tests/fakes.

Tests import makers by their names (``pythonpath`` in pyproject.toml); this file does so inside its fixtures, since the
environment of tests/clients holds neither the product nor hypothesis.
"""

import importlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# two workers on two cores: a second thread of each matrix product takes the other worker's core and gives nothing
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# all processes of all runs share what numba (beside the sources, by the installation) and Python compile
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

_BEGAN = pytest.StashKey[os.times_result]()

#: of a test that names no number of its own: with every push and every night all hundred
FAST_EXAMPLES = 25

if importlib.util.find_spec("hypothesis") is not None:  # the environment of tests/clients does without
    from hypothesis import HealthCheck, settings

    # the time that an example, or the drawing of one, takes judges the machine; the limit of pytest bounds hangs
    untimed = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
    settings.register_profile("fast", **untimed, max_examples=FAST_EXAMPLES)
    # the same examples at every run: a change is not refused for a counterexample of another one, found by chance
    settings.register_profile("ci", **untimed, derandomize=True)
    settings.register_profile("nightly", **untimed)
    settings.load_profile(os.environ.get("SOO_TEST_PROFILE", "fast"))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what repeats evidence: further seeds, and a second database, theme or language.

    The second seed is slow, of a slow test nightly; others, and what is not the first of its kind, are nightly. Ports
    keep both databases.
    """
    for item in items:
        if (call := getattr(item, "callspec", None)) is None:
            continue
        texts = {value for value in call.params.values() if isinstance(value, str)}
        number = call.indices.get("seed", 0)
        repeats = number > (item.get_closest_marker("slow") is None)
        if repeats or texts & {"light", "ru"} or ("postgresql" in texts and not item.path.stem.endswith("_port")):
            item.add_marker("nightly")
        elif number == 1 or "postgresql" in texts:
            item.add_marker("slow")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Count the processor time of a test and of the processes that it waited for, setup included."""
    item.stash[_BEGAN] = os.times()
    return (yield)


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item) -> None:
    """Write the processor time into the file of durations (tests/durations.py)."""
    used_s = sum(os.times()[:4]) - sum(item.stash[_BEGAN][:4])
    item.user_properties.append(("processor_s", f"{used_s:.2f}"))


@pytest.fixture
def anyio_backend() -> str:
    """Run asynchronous tests on asyncio."""
    return "asyncio"


@pytest.fixture
def payload() -> object:
    """Twelve carriers with known slopes and harmonics."""
    from synthetic_payload import SyntheticPayload

    return SyntheticPayload.make()


@pytest.fixture(scope="session")
def empty_database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a migrated SQLite file of which tests take copies."""
    from db.storage import SqlStorage

    path = tmp_path_factory.mktemp("archive") / "empty.db"
    storage = SqlStorage(f"sqlite:///{path}")
    storage.prepare()
    storage.close()
    return path


@pytest.fixture(scope="session")
def postgresql_cluster() -> Iterator[object]:
    """One PostgreSQL server a session; skips, and says why, where there is none."""
    from postgresql_cluster import NoServerError, PostgresqlCluster

    try:
        cluster = PostgresqlCluster()
    except NoServerError as fault:
        pytest.skip(str(fault))
    yield cluster
    cluster.close()


@pytest.fixture(scope="session")
def durable_postgresql_cluster() -> Iterator[object]:
    """One PostgreSQL server a session whose commits survive a kill; skips, and says why, where there is none."""
    from postgresql_cluster import NoServerError, PostgresqlCluster

    try:
        cluster = PostgresqlCluster(fsync=True)
    except NoServerError as fault:
        pytest.skip(str(fault))
    yield cluster
    cluster.close()
