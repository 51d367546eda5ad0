"""Keys and streams of clients with a real service."""

import asyncio
import json
import random
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from urllib.parse import quote

import httpx
import pytest
from typer.testing import CliRunner
from waiting import wait_until

from service.cli.app import app
from service.client.async_service_client import AsyncServiceClient
from service.client.service_client import ServiceClient, StreamEvent
from service.records.epoch import format_epoch

pytestmark = [pytest.mark.system, pytest.mark.slow]


BASE = "/api/v1/spacecraft"
#: a connection without a request is ended after so long
HANDSHAKE_S = 3


def soo(*arguments: str, key: str = "", environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a command of the product."""
    command = [sys.executable, "-m", "service", *arguments]
    whole = {**environment, "SOO_KEY": key}
    return subprocess.run(command, env=whole, capture_output=True, text=True, timeout=120, check=False)


def bearer(key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"}


def get(url: str, key: str, **options: object) -> httpx.Response:
    return httpx.get(url, headers=bearer(key), trust_env=False, timeout=120, **options)


def test_the_first_administrators_key_is_a_file_and_no_key_is_ever_told(start_service, compiled_environment, tmp_path):
    """Keys made, used, misused and revoked, over the interface and by commands; then all outputs are searched."""
    settings = {"SOO_BOOTSTRAP_KEY": "", "SOO_LOG_LEVEL": "debug"}
    service = start_service("--port", "0", environment=settings, database=tmp_path / "soo.db")
    url = service.url
    key_file = tmp_path / "administrator.key"
    assert str(key_file) in service.log.read_text()
    admin = key_file.read_text().strip()
    # only their owner can read what holds secrets, its companions too
    modes = {path.name: oct(path.stat().st_mode & 0o777) for path in tmp_path.glob("soo.db*")}
    assert modes == dict.fromkeys(("soo.db", "soo.db-wal", "soo.db-shm", "soo.db-lease"), "0o600")
    assert key_file.stat().st_mode & 0o777 == 0o600
    listed = get(f"{url}/api/v1/keys", admin).json()["rows"]
    assert [(row["name"], row["role"]) for row in listed] == [("first administrator", "admin")]
    made = soo(
        *("keys", "create", "--name", "olga", "--role", "operator", "--service", url),
        key=admin,
        environment=compiled_environment,
    )
    assert made.returncode == 0, made.stderr
    key = made.stdout.strip()
    key_id = key.split("_")[1]
    assert get(url + BASE, key).status_code == 200
    # a whole key in place of its id, and no right to it either
    refused = soo("keys", "revoke", key, "--service", url, key=key, environment=compiled_environment)
    assert (refused.returncode, "403" in refused.stderr) == (1, True), refused.stderr
    wrong = key[:-1] + ("A" if key[-1] != "A" else "B")
    answers = [
        httpx.get(url + BASE, headers={**bearer(wrong), "X-Forwarded-For": "192.0.2.77"}, trust_env=False, timeout=120),
        get(url + BASE, key, params={"key": key}),
        get(f"{url}/api/v1/keys/{key}", key),
        get(f"{url}/api/v1/{key}", wrong),
        *(get(f"{url}/api/v1/spacecraft/{key}{path}", admin) for path in ("", "/status", "/calibrations/1")),
        httpx.put(
            f"{url}/api/v1/spacecraft/{key}/ephemeris", headers=bearer(admin), json={}, trust_env=False, timeout=120
        ),
        get(f"{url}/api/v1/jobs/{key}", admin),
        get(f"{url}/api/v1/links/{key}", admin),
        httpx.delete(f"{url}/api/v1/keys/{key}", headers=bearer(admin), trust_env=False, timeout=120),
        httpx.post(url + BASE, headers=bearer(key), json={"id": key}, trust_env=False, timeout=120),
        get(f"{url}/api/v1/keys", admin),
    ]
    processes = subprocess.run(["ps", "axww", "-o", "args"], capture_output=True, text=True, check=True).stdout
    assert (
        httpx.delete(f"{url}/api/v1/keys/{key_id}", headers=bearer(admin), trust_env=False, timeout=120).status_code
        == 204
    )
    assert get(url + BASE, key).status_code == 401
    audit = get(f"{url}/api/v1/audit", admin).json()
    service.end()
    assert {row["address"] for row in audit["rows"]} == {"", "127.0.0.1"}
    # heads of the chain are announced at the start and at the end, where a change of the database does not reach
    where = ("--database", f"sqlite:///{tmp_path / 'soo.db'}", "--log", str(service.log), "--json")
    verified = CliRunner().invoke(app, ["audit", "verify", *where])
    assert (verified.exit_code, json.loads(verified.output)["heads"]) == (0, 2), verified.output
    assert json.loads(verified.output)["number"] >= audit["head"]["number"]
    reported = [made.stderr, refused.stdout, refused.stderr, processes, json.dumps(audit), service.written()]
    reported += [answer.text + str(answer.headers) for answer in answers]
    files = b"".join(path.read_bytes() for path in tmp_path.iterdir() if path.is_file())
    for secret in (key.split("_", 2)[2], wrong.split("_", 2)[2], admin.split("_", 2)[2]):
        assert sum(text.count(secret) for text in reported) == 0
        # the administrator's in its file
        assert files.count(secret.encode()) == (1 if secret in admin else 0)
    # the second start knows the administrator, and this time believes the proxy
    again = start_service("--port", "0", environment={**settings, "SOO_TRUSTED_PROXIES": "127.0.0.0/8"})
    forwarded = {**bearer("wrong"), "X-Forwarded-For": "192.0.2.77"}
    assert httpx.get(again.url + BASE, headers=forwarded, trust_env=False, timeout=120).status_code == 401
    newest = get(f"{again.url}/api/v1/audit", admin, params={"outcome": "401"}).json()["rows"][-1]
    assert newest["address"] == "192.0.2.77"
    assert "administrator's key" not in again.written()
    assert list(tmp_path.glob("administrator*")) == [key_file]


def test_secrets_come_from_files_and_a_bootstrap_key_in_a_path_is_told_to_nobody(
    start_service, compiled_environment, tmp_path
):
    folder = tmp_path / "secrets"
    folder.mkdir()
    key = "a bootstrap/key of no form"
    (folder / "soo_bootstrap_key").write_text(f"{key}\n")
    (folder / "client").write_text(f"{key}\n")
    service = start_service("--port", "0", environment={"SOO_SECRETS_DIR": str(folder), "SOO_LOG_LEVEL": "debug"})
    files = {**compiled_environment, "SOO_KEY_FILE": str(folder / "client")}
    listed = soo("keys", "list", "--service", service.url, environment=files)
    assert listed.returncode == 0, listed.stderr
    answers = [
        get(f"{service.url}{BASE}/{path}", key)
        for path in (quote(key, safe=""), f"{quote(key)}/status", f"x/calibrations/{quote(key, safe='')}")
    ]
    answers.append(httpx.get(f"{service.url}{BASE}/{quote(key, safe='')}", trust_env=False, timeout=120))
    assert {answer.status_code for answer in answers} <= {401, 404, 422}
    audit = get(f"{service.url}/api/v1/audit", key).text
    service.end()
    assert key not in "".join([*(answer.text for answer in answers), audit, service.written()])
    assert not list(tmp_path.glob("administrator*"))
    lacking = soo("keys", "list", environment={**compiled_environment, "SOO_KEY_FILE": str(folder / "none")})
    assert (lacking.returncode, "cannot be read" in lacking.stderr) == (2, True)


def test_a_start_that_cannot_have_or_keep_its_key_says_so(refused_starts, tmp_path):
    (tmp_path / "administrator.key").symlink_to(tmp_path / "none")
    arguments = ["--port", "0", "--database", f"sqlite:///{tmp_path / 'soo.db'}"]
    unread, unwritten = refused_starts((arguments, {"SOO_SECRETS_DIR": str(tmp_path / "none")}), (arguments, {}))
    assert (unread[0], "no folder" in unread[1]) == (2, True), unread
    assert (unwritten[0], "administrator.key" in unwritten[1]) == (2, True), unwritten


@pytest.fixture
def certificate(tmp_path: Path) -> tuple[Path, Path]:
    """A certificate of its own for 127.0.0.1, and its key."""
    certificate, key = tmp_path / "certificate.pem", tmp_path / "key.pem"
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    command += ["-days", "2", "-subj", "/CN=soo-test", "-addext", "subjectAltName=IP:127.0.0.1"]
    subprocess.run([*command, "-keyout", str(key), "-out", str(certificate)], check=True, capture_output=True)
    return certificate, key


def test_https_is_served_old_protocols_are_not_and_a_handshake_that_does_not_begin_is_ended(start_service, certificate):
    chain, key = certificate
    environment = {"SOO_BOOTSTRAP_KEY": "a-key-for-tests-only", "SOO_REQUEST_TIMEOUT_S": str(HANDSHAKE_S)}
    service = start_service(
        "--port", "0", "--tls-certificate", str(chain), "--tls-key", str(key), environment=environment
    )
    announced = service.await_announcement()
    assert announced["api"].startswith("https://127.0.0.1:")
    began = time.monotonic()
    with socket.create_connection(("127.0.0.1", int(service.url.rpartition(":")[2])), timeout=120) as silent:
        trusting = ssl.create_default_context(cafile=str(chain))
        assert get(service.url + BASE, "a-key-for-tests-only", verify=trusting).status_code == 200
        with pytest.raises(httpx.ConnectError):
            get(service.url + BASE, "a-key-for-tests-only")
        with pytest.raises(httpx.HTTPError):
            get(service.url.replace("https", "http") + BASE, "a-key-for-tests-only")
        old = ssl.create_default_context(cafile=str(chain))
        old.set_ciphers("ALL:@SECLEVEL=0")
        with pytest.warns(DeprecationWarning, match="TLSv1"):
            old.minimum_version, old.maximum_version = ssl.TLSVersion.TLSv1, ssl.TLSVersion.TLSv1_1
        with pytest.raises(httpx.HTTPError):
            get(service.url + BASE, "a-key-for-tests-only", verify=old)
        # like who sends no head
        assert silent.recv(100) == b""
    # the server's own limit is 60 s
    assert 0.9 * HANDSHAKE_S < time.monotonic() - began < 50
    assert service.end()[0] == 0


def test_a_certificate_that_cannot_be_used_and_a_proxy_that_is_everybody_are_refused(
    refused_starts, certificate, tmp_path
):
    chain, key = map(str, certificate)
    other, packed = str(tmp_path / "other.pem"), str(tmp_path / "packed.pem")
    subprocess.run(["openssl", "genrsa", "-out", other, "2048"], check=True, capture_output=True)
    command = ["openssl", "pkey", "-in", key, "-aes256", "-passout", "pass:word", "-out", packed]
    subprocess.run(command, check=True, capture_output=True)
    given = ["--port", "0", "--database", f"sqlite:///{tmp_path / 'soo.db'}", "--tls-certificate", chain]
    keys = ([], *(["--tls-key", path] for path in (str(tmp_path / "none.pem"), other, packed)))
    everybody = ([], {"SOO_BOOTSTRAP_KEY": "x", "SOO_TRUSTED_PROXIES": "*"})
    ended = refused_starts(*(([*given, *words], {}) for words in keys), everybody)
    said = ["go together", *["cannot use certificate"] * 3, "trusted_proxies"]
    for (code, output), words in zip(ended, said, strict=True):
        assert (code, words in output) == (2, True), (code, output)
    assert not (tmp_path / "soo.db").exists()


KEY = "a-key-for-tests-only"
SEED = 20261122
KILLS = 2
SC = "sim-1"


class Sender(threading.Thread):
    """Sends a row every few milliseconds and remembers what was acknowledged."""

    def __init__(self, url: str, plan_id: int) -> None:
        super().__init__()
        self._client = ServiceClient(url, KEY, retries=200, first_wait_s=0.05)
        self._plan_id = plan_id
        self._is_over = threading.Event()
        self.acknowledged: list[str] = []

    def run(self) -> None:
        number = 0
        while not self._is_over.wait(0.01):
            number += 1
            row = {
                "epoch": format_epoch(1_795_000_000_000_000 + 1_000_000 * number),
                "power_dbm": [-40.0 - number % 7] * 16,
            }
            receipt = self._client.post_measurements(SC, self._plan_id, [row], source="sa-1")
            assert receipt["accepted"] + receipt["duplicates"] == 1, receipt
            self.acknowledged.append(row["epoch"])

    def finish(self) -> None:
        self._is_over.set()
        self.join(120)
        self._client.close()


def follow(url: str, events: list[StreamEvent], last: threading.Event, wanted: set[str]) -> None:
    """Follow with the synchronous client until every wanted row has come."""
    with ServiceClient(url, KEY) as client:
        for event in client.stream(SC, patience_s=120):
            events.append(event)
            if last.is_set() and wanted <= epochs(events):
                return


async def follow_async(url: str, events: list[StreamEvent], last: threading.Event, wanted: set[str]) -> None:
    """Follow with the asynchronous client until every wanted row has come."""
    async with AsyncServiceClient(url, KEY) as client:
        async for event in client.stream(SC, patience_s=120):
            events.append(event)
            if last.is_set() and wanted <= epochs(events):
                return


def epochs(events: list[StreamEvent]) -> set[str]:
    """Return the epochs of the rows that were told."""
    return {event.data["epoch"] for event in list(events) if event.kind == "measurement"}


def test_streams_survive_kills_of_the_service_without_loss_or_doubling(start_service, spacecraft, carriers):
    print(f"seed {SEED}")
    instants = random.Random(SEED)
    service = start_service()
    url = service.url
    with ServiceClient(url, KEY, timeout_s=120) as client:
        client.create_spacecraft(spacecraft)
        plan_id = client.put_carriers(SC, carriers)["plan_id"]
    reported: dict[str, list[StreamEvent]] = {"sync": [], "async": []}
    last, wanted = threading.Event(), set()
    readers = [
        threading.Thread(target=follow, args=(url, reported["sync"], last, wanted)),
        threading.Thread(target=lambda: asyncio.run(follow_async(url, reported["async"], last, wanted))),
    ]
    for reader in readers:
        reader.start()
    # both have an id to go on from before the first row is sent
    wait_until(lambda: all(reported.values()))
    sender = Sender(url, plan_id)
    sender.start()
    for _ in range(KILLS):
        time.sleep(instants.uniform(0.2, 1.0))
        service.process.kill()
        service.process.wait()
        service = start_service("--port", url.rpartition(":")[2], "--clock", "data")
        service.await_announcement()
    time.sleep(0.5)
    sender.finish()
    wanted.update(sender.acknowledged)
    last.set()
    with ServiceClient(url, KEY, timeout_s=120) as client:
        # one more row wakes readers that have everything already
        row = {"epoch": format_epoch(1_795_000_000_000_000 + 1_000_000 * 100_000), "power_dbm": [-40.0] * 16}
        client.post_measurements(SC, plan_id, [row], source="sa-1")
        stored = [
            row["epoch"] for row in client.measurement_history(SC, "2026-01-01T00:00:00Z", "2027-01-01T00:00:00Z")
        ]
    for reader in readers:
        reader.join(120)
        assert not reader.is_alive()
    print(f"{len(wanted)} rows acknowledged, {KILLS} kills")
    assert len(wanted) > KILLS
    assert wanted <= set(stored)
    for name, events in reported.items():
        counts = Counter(event.data["epoch"] for event in events if event.kind == "measurement")
        assert wanted <= counts.keys(), name
        assert set(counts.values()) == {1}, name
        assert not [event for event in events if event.kind == "dropped"], name
        # the order of the journal, which here is that of the epochs
        assert list(counts) == sorted(counts), name
    assert service.end()[0] == 0
