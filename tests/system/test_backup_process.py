"""``soo backup`` beside a service under load: what was acknowledged before it began is in it, and it serves again."""

import json
import subprocess
import sys
import time

import pytest

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(180)]

SEED = 23


def soo(*arguments):
    """Run a command and return its exit code and what it printed as JSON."""
    command = [sys.executable, "-m", "service", *map(str, arguments), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert "Traceback" not in done.stderr, done.stderr
    return done.returncode, json.loads(done.stdout) if done.stdout else done.stderr


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_backup_under_load_holds_what_was_acknowledged_before_it_began(
    request, start_service, spacecraft, carriers, chaos, tmp_path, kind
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
        time.sleep(1.0)
        before = chaos.promised(clients)
        code, manifest = soo("backup", "create", tmp_path / "b", "--database", url)
        assert code == 0, manifest
        counts = chaos.finish(clients)
        after = chaos.promised(clients)
        assert 0 < len(before) < len(after)
        assert counts["repetitions"] == 0, "the backup kept clients from posting"
        # the archive goes on behind the backup
        chaos.compare(client, after)
    assert len(before) <= manifest["tables"]["measurement"] <= len(after)
    code, verified = soo("backup", "verify", tmp_path / "b")
    assert (code, verified["state"]) == (0, "ok"), verified
    code, said = soo("backup", "restore", tmp_path / "b", "--database", url, "--replace")
    assert code == 1
    assert "stop the service first" in said
    assert service.end()[0] == 0
    code, said = soo("backup", "restore", tmp_path / "b", "--database", url)
    assert code == 1
    assert "--replace" in said
    code, restored = soo("backup", "restore", tmp_path / "b", "--database", url, "--replace")
    assert code == 0, restored
    assert "before" in restored["kept"]
    again = start_service(*options, url)
    with again.client() as client:
        told = {(row["source"], row["epoch"]): row["power_dbm"] for row in chaos.history(client)}
        assert len(told) == manifest["tables"]["measurement"]
        names = {(source, chaos.text_of(epoch_us)) for source, epoch_us in before}
        assert names <= told.keys() <= {(source, chaos.text_of(epoch_us)) for source, epoch_us in after}
        in_backup = {row: powers for row, powers in after.items() if (row[0], chaos.text_of(row[1])) in told}
        chaos.await_consumed(client, in_backup)
        chaos.compare(client, in_backup)
    assert again.end()[0] == 0
    code, health = soo("doctor", "--database", url)
    assert code in (0, 3), health
