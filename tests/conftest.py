"""Fixtures that several trees of tests share; the makers themselves lie in tests/fakes."""

import importlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]
# two workers on two cores: a second thread of each matrix product takes the other worker's core and gives nothing
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# all processes of all runs share what numba and Python compile: a start takes half the time
os.environ.setdefault("NUMBA_CACHE_DIR", str(ROOT / ".cache" / "numba"))
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

#: of a test that names no number of its own: with every push all hundred
FAST_EXAMPLES = 25

if importlib.util.find_spec("hypothesis") is not None:  # the environment of tests/clients does without
    from hypothesis import settings

    # a time limit of an example judges the machine; the one of pytest bounds hangs
    settings.register_profile("fast", deadline=None, max_examples=FAST_EXAMPLES)
    settings.register_profile("ci", deadline=None)
    settings.load_profile(os.environ.get("SOO_TEST_PROFILE", "fast"))


@pytest.fixture
def anyio_backend() -> str:
    """Run asynchronous tests on asyncio."""
    return "asyncio"


def _load(name: str) -> ModuleType:
    """Return a module of tests/fakes; `pythonpath` in pyproject.toml names its folders."""
    return importlib.import_module(name)


@pytest.fixture(scope="session")
def synthetic() -> ModuleType:
    """Makers of a small payload whose every figure is chosen."""
    return _load("synthetic_payload")


@pytest.fixture
def payload(synthetic):
    """Twelve carriers with known slopes and harmonics."""
    return synthetic.SyntheticPayload.make()


@pytest.fixture(scope="session")
def filter_models() -> ModuleType:
    """Small carrier models for the attitude filter."""
    return _load("filter_models")


@pytest.fixture(scope="session")
def robust_world() -> ModuleType:
    """The attitude filter over worlds of the simulator."""
    return _load("robust_world")


@pytest.fixture(scope="session")
def empty_database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a migrated SQLite file of which tests take copies."""
    from db.storage import SqlStorage  # the environment of tests/clients has no database

    path = tmp_path_factory.mktemp("archive") / "empty.db"
    storage = SqlStorage(f"sqlite:///{path}")
    storage.migrate()
    storage.close()
    return path


@pytest.fixture(scope="session")
def postgresql_cluster() -> Iterator[object]:
    """One PostgreSQL server a session; skips, and says why, where there is none."""
    module = _load("postgresql_cluster")
    try:
        cluster = module.PostgresqlCluster()
    except module.NoServerError as fault:
        pytest.skip(str(fault))
    yield cluster
    cluster.close()


@pytest.fixture(scope="session")
def durable_postgresql_cluster() -> Iterator[object]:
    """One PostgreSQL server a session whose commits survive a kill; skips, and says why, where there is none."""
    module = _load("postgresql_cluster")
    try:
        cluster = module.PostgresqlCluster(fsync=True)
    except module.NoServerError as fault:
        pytest.skip(str(fault))
    yield cluster
    cluster.close()


@pytest.fixture(scope="session")
def chaos() -> ModuleType:
    """Posting clients for chaos tests."""
    return _load("chaos_clients")
