"""Archives that several services may use."""

import pytest


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request, tmp_path):
    """URL of an archive that two services may use."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path / 'soo.db'}"
        return
    cluster = request.getfixturevalue("durable_postgresql_cluster")
    made = cluster.new_database()
    yield made
    cluster.drop(made)
