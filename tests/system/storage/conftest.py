"""Archives that several services may use."""

import pytest


@pytest.fixture
def durable_url(durable_postgresql_cluster):
    """URL of an empty database on a server that keeps what it has acknowledged."""
    made = durable_postgresql_cluster.new_database()
    yield made
    durable_postgresql_cluster.drop(made)


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request, tmp_path):
    """URL of an archive that two services may use."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'soo.db'}"
    return request.getfixturevalue("durable_url")
