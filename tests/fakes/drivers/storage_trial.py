"""A running service, clients that post to it through a fault of its storage, and volumes that break."""

import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from db.maintenance.doctor import diagnose
from service.runtime.clock import system_now_us

SEED = 22
BASE = "/api/v1/spacecraft/sim-1"
#: who waits for a lock gives up after 2 s in place of 10 s
IMPATIENT = {"SOO_DATABASE_TIMEOUT_S": "2"}


def doubtful(url):
    """Return what is not as it should be in an archive; the disk of the tests' machine may be small."""
    found = diagnose(url, system_now_us(), lambda _: None)
    return [each for each in found if each.state != "ok" and each.check != "disk"]


class Trial:
    """A service, two clients that post to it, and what can be done to its file."""

    def __init__(self, start_service, chaos, spacecraft, carriers, folder, options=(), settings=None):
        self.chaos, self.file = chaos, folder / "soo.db"
        key = "a-key-for-tests-only"
        self.environment = {"SOO_BOOTSTRAP_KEY": key, **(settings or {})}
        self.service = start_service("--port", "0", "--clock", "data", *options, environment=self.environment)
        self.client = self.service.client()
        self.plan_id = chaos.set_up(self.client, spacecraft, carriers)
        self.clients = chaos.start_clients(self.service.url, key, self.plan_id, SEED, clients=2)
        self.await_counts(lambda counts: counts["accepted"] > 100)

    def counts(self):
        """Return what the clients have counted so far."""
        found = self.clients[0].counts + self.clients[1].counts
        return found + self.clients[0].codes + self.clients[1].codes

    def slowest_s(self):
        """Return the longest time that a client has waited for an answer."""
        return max(client.slowest_s for client in self.clients)

    def await_counts(self, is_enough, timeout_s=120.0):
        """Wait until the clients have counted enough."""
        deadline = time.monotonic() + timeout_s
        while not is_enough(self.counts()):
            assert time.monotonic() < deadline, f"{dict(self.counts())}\n{self.service.written()[-3000:]}"
            assert not (faults := [client.faults for client in self.clients if client.faults]), faults
            time.sleep(0.02)

    def await_code(self, code, more=3):
        """Wait until the clients were refused some times more with a code."""
        before = self.counts()[code]
        self.await_counts(lambda counts: counts[code] >= before + more)

    def await_rows(self, more=50):
        """Wait until the service takes rows again."""
        before = self.counts()["accepted"]
        self.await_counts(lambda counts: counts["accepted"] >= before + more)

    def read(self):
        """Return the status and code of a read of the history."""
        answer = self.client.get(f"{BASE}/measurements/history", params={"limit": 5})
        if answer.status_code == 503:
            assert int(answer.headers["Retry-After"]) >= 1
            return 503, answer.json()["code"]
        return answer.status_code, None

    def conclude(self, url=None):
        """Demand that all that was promised is there, once, with its results, and that nothing is wrong."""
        self.await_rows()
        counts = self.chaos.finish(self.clients)
        promised = self.chaos.promised(self.clients)
        self.chaos.await_consumed(self.client, promised)
        reported = self.chaos.compare(self.client, promised)
        print(reported, dict(counts))
        assert doubtful(url or f"sqlite:///{self.file}") == []
        assert self.service.end()[0] == 0
        assert "Internal Server Error" not in self.service.written()


@contextmanager
def small_volume(folder, size):
    """Mount a volume of some size; skip where that is not allowed."""
    folder.mkdir()
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], capture_output=True, check=False
    )
    if done.returncode:
        pytest.skip(f"volumes cannot be mounted here: {done.stderr.decode().strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


class DiskVolume:
    """A volume of its own on a file, with the file system of a disk."""

    def __init__(self, folder: Path, size: str) -> None:
        self.folder, self._image = folder, folder.with_suffix(".img")
        folder.mkdir()
        _run("truncate", "-s", size, str(self._image))
        _run("mkfs.ext4", "-q", str(self._image))
        self._mount()

    def fail(self) -> None:
        """Do what the system does when the disk fails: nothing can be written from now on."""
        _run("mount", "-o", "remount,abort", str(self.folder))

    def repair(self) -> None:
        """Check the file system, as at a start of the machine; nobody may use it."""
        self.close()
        subprocess.run(["e2fsck", "-p", self._image], capture_output=True, check=False)
        self._mount()

    def close(self) -> None:
        """Take the volume away."""
        subprocess.run(["umount", "-l", self.folder], check=True)

    def _mount(self) -> None:
        _run("mount", "-o", "loop,errors=remount-ro", str(self._image), str(self.folder))


def _run(*command: str) -> None:
    """Run a program; skip where it is missing or not allowed."""
    try:
        subprocess.run(command, capture_output=True, check=True)
    except FileNotFoundError:
        pytest.skip(f"there is no {command[0]} here")
    except subprocess.CalledProcessError as fault:
        pytest.skip(f"volumes cannot be mounted here: {fault.stderr.decode().strip()}")


@contextmanager
def disk_volume(folder: Path, size: str) -> Iterator[DiskVolume]:
    """Make and mount a volume of some size; skip where that is not allowed."""
    volume = DiskVolume(folder, size)
    try:
        yield volume
    finally:
        volume.close()
