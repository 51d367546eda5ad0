"""``soo backup`` beside a service under load: what was acknowledged before it began is in it, and it serves again."""

import json
import subprocess
import sys
import time

import chaos_clients as chaos
import pytest

from db.maintenance.backup import verify_backup
from db.maintenance.doctor import diagnose
from db.maintenance.restore import restore_backup
from service.records.storage.backup import BackupError
from service.records.storage.diagnosis import worst
from service.runtime.clock import system_now_us

pytestmark = [pytest.mark.system, pytest.mark.slow]

SEED = 23


def ignore(*_):
    """Tell nobody of the progress."""


def create(folder, url):
    """Make a backup from another process and return its manifest."""
    command = [sys.executable, "-m", "service", "backup", "create", str(folder), "--database", url, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_backup_under_load_holds_what_was_acknowledged_before_it_began(
    request, start_service, spacecraft, carriers, tmp_path, kind
):
    if kind == "sqlite":
        url = f"sqlite:///{tmp_path / 'soo.db'}"
    else:
        cluster = request.getfixturevalue("durable_postgresql_cluster")
        url = cluster.new_database()
        request.addfinalizer(lambda: cluster.drop(url))
    options = ("--port", "0", "--clock", "data", "--database")
    service = start_service(*options, url)
    with service.client() as client:
        plan_id = chaos.set_up(client, spacecraft, carriers)
        clients = chaos.start_clients(service.url, "a-key-for-tests-only", plan_id, SEED)
        deadline = time.monotonic() + 120
        while not (before := chaos.promised(clients)):
            assert time.monotonic() < deadline, [client.faults for client in clients]
            time.sleep(0.05)
        manifest = create(tmp_path / "b", url)
        counts = chaos.finish(clients)
        after = chaos.promised(clients)
        assert len(before) < len(after)
        assert counts["repetitions"] == 0, "the backup kept clients from posting"
        # the archive goes on behind the backup
        chaos.compare(client, after)
    assert len(before) <= manifest["tables"]["measurement"] <= len(after)
    assert worst(verify_backup(tmp_path / "b", ignore)) == "ok"
    with pytest.raises(BackupError, match="stop the service first"):
        restore_backup(tmp_path / "b", url, "x", ignore, may_replace=True)
    assert service.end()[0] == 0
    assert restore_backup(tmp_path / "b", url, "x", ignore, may_replace=True).aside is not None
    again = start_service(*options, url)
    with again.client() as client:
        reported = {(row["source"], row["epoch"]) for row in chaos.history(client)}
        assert len(reported) == manifest["tables"]["measurement"]
        assert reported >= {(source, chaos.text_of(epoch_us)) for source, epoch_us in before}
        in_backup = {row: powers for row, powers in after.items() if (row[0], chaos.text_of(row[1])) in reported}
        chaos.await_consumed(client, in_backup)
        chaos.compare(client, in_backup)
    assert again.end()[0] == 0
    found = diagnose(url, system_now_us(), ignore)
    assert [each for each in found if each.state != "ok" and each.check != "disk"] == []
