"""A restored archive is the archive: same history, and a replay of it gives the live rows to the last bit."""

import pytest
import synthetic_payload as synthetic

from db.maintenance.backup import create_backup, verify_backup
from db.maintenance.restore import restore_backup
from service.records.storage.diagnosis import worst


def ignore(*_):
    """Tell nobody of the progress."""


@pytest.fixture
def target(request, tmp_path):
    """URL of a database without a schema."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path / 'restored.db'}"
        return
    cluster = request.getfixturevalue("postgresql_cluster")
    url = cluster.new_database()
    yield url
    cluster.drop(url)


@pytest.mark.parametrize("is_sealed", [False, True], ids=["rows", "sealed"])
@pytest.mark.parametrize("target", ["sqlite", "postgresql"], indirect=True)
def test_a_replay_of_a_restored_archive_is_the_live_run_bit_for_bit(lived, payload, target, tmp_path, is_sealed):
    if is_sealed:
        assert sum(part.rows for part in lived.storage.archive.seal(lived.id, 1 << 60, 1 << 60)) > 1000
    live = [repr(row) for row in lived.rows()]
    commands = [repr(item) for item in lived.commands()]
    entries = repr(lived.storage.archive.journal(lived.id, 0, 100_000))
    # the archive stays open, as under a running service
    create_backup(f"sqlite:///{tmp_path / 'lived' / 'soo.db'}", tmp_path / "backup", 1, ignore)
    assert worst(verify_backup(tmp_path / "backup", ignore)) == "ok"
    restore_backup(tmp_path / "backup", target, "x", ignore, may_replace=False)
    restored = type(lived)(target, payload, synthetic)
    try:
        assert repr(restored.storage.archive.journal(lived.id, 0, 100_000)) == entries
        assert [repr(row) for row in restored.rows()] == live
        version = restored.replay(1, 300)
        assert [repr(row) for row in restored.rows(version)] == live
        assert [repr(item) for item in restored.commands(version)] == commands
    finally:
        restored.close()
