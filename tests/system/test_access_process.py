"""Keys, audit log and TLS as operators meet them: a service process, its commands, and everything that they write."""

import os
import secrets
import sqlite3
import ssl
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]

BASE = "/api/v1/spacecraft"


def soo(*arguments: str, key: str = "", environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a command of the product."""
    command = [sys.executable, "-m", "service", *arguments]
    whole = {**environment, "SOO_KEY": key}
    return subprocess.run(command, env=whole, capture_output=True, text=True, timeout=60, check=False)


def bearer(key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"}


def get(url: str, key: str, **options: object) -> httpx.Response:
    return httpx.get(url, headers=bearer(key), trust_env=False, timeout=10, **options)


def test_a_first_start_makes_one_administrator_and_the_second_none(start_service):
    service = start_service(environment={"SOO_BOOTSTRAP_KEY": ""})
    url = service.url
    fresh = service.log.read_text().split("kept nowhere: ")[1].split()[0]
    assert get(url + BASE, fresh).status_code == 200
    listed = get(f"{url}/api/v1/keys", fresh).json()["rows"]
    assert [(row["name"], row["role"]) for row in listed] == [("first administrator", "admin")]
    service.end()
    again = start_service(environment={"SOO_BOOTSTRAP_KEY": ""})
    assert get(again.url + BASE, fresh).status_code == 200
    assert "kept nowhere" not in again.written()


def test_keys_are_never_written_by_anybody(start_service, compiled_environment, tmp_path):
    """Keys made, used, misused and revoked, over the interface and by commands; then all outputs are searched."""
    bootstrap = "boot-" + secrets.token_urlsafe(24)
    service = start_service(
        "--port", "0", environment={"SOO_BOOTSTRAP_KEY": bootstrap, "SOO_LOG_LEVEL": "debug", "SOO_CLOCK": "data"}
    )
    where = ("--service", service.url)
    environment = dict(compiled_environment)
    made = soo("keys", "create", "--name", "olga", "--role", "operator", *where, key=bootstrap, environment=environment)
    assert made.returncode == 0, made.stderr
    key = made.stdout.strip()
    key_id = key.split("_")[1]
    assert get(service.url + BASE, key).status_code == 200
    said = [made.stderr]
    for arguments, expected in (
        (("keys", "list"), 1),
        (("keys", "create", "--name", "x", "--role", "admin"), 1),
        (("keys", "revoke", key), 1),
    ):
        refused = soo(*arguments, *where, key=key, environment=environment)
        assert (refused.returncode, "403" in refused.stderr) == (expected, True), refused.stderr
        said += [refused.stdout, refused.stderr]
    wrong = key[:-1] + ("A" if key[-1] != "A" else "B")
    answers = [
        get(service.url + BASE, wrong),
        get(service.url + BASE, key, params={"limit": "x"}),
        get(f"{service.url}/api/v1/keys/{key}", key),
        get(f"{service.url}/api/v1/{key}", wrong),
        httpx.delete(f"{service.url}/api/v1/keys/{key}", headers=bearer(bootstrap), trust_env=False),
        httpx.post(service.url + BASE, headers=bearer(key), json={"id": key}, trust_env=False),
        get(service.url + "/docs", key),
    ]
    listing = soo("keys", "list", "--json", *where, key=bootstrap, environment=environment)
    processes = subprocess.run(["ps", "axww", "-o", "args"], capture_output=True, text=True, check=True).stdout
    revoked = soo("keys", "revoke", key_id, *where, key=bootstrap, environment=environment)
    assert revoked.returncode == 0, revoked.stderr
    assert get(service.url + BASE, key).status_code == 401
    audit = get(f"{service.url}/api/v1/audit", bootstrap)
    service.end()
    said += [listing.stdout, listing.stderr, revoked.stdout, revoked.stderr, processes, audit.text, service.written()]
    said += [answer.text + str(answer.headers) for answer in answers]
    files = b"".join(path.read_bytes() for path in tmp_path.iterdir() if path.is_file())
    assert key_id in audit.text
    for secret in (key.split("_", 2)[2], wrong.split("_", 2)[2], bootstrap):
        assert not any(secret in text for text in said)
        assert secret.encode() not in files


def test_the_audit_log_is_verified_beside_a_running_service_and_a_change_is_found(
    start_service, spacecraft, compiled_environment, tmp_path
):
    service = start_service()
    with service.client() as client:
        assert client.post(BASE, json=spacecraft).status_code == 201
        for k in range(3):
            assert client.patch(f"{BASE}/sim-1", json={"name": f"N{k}"}).status_code == 200
        head = client.get("/api/v1/audit").json()["head"]
    database = f"sqlite:///{tmp_path / 'soo.db'}"
    verify = ("audit", "verify", "--database", database)
    whole = soo(*verify, "--head", f"{head['number']}:{head['hash']}", environment=compiled_environment)
    assert (whole.returncode, whole.stdout.startswith("whole: 4 entries")) == (0, True), whole.stdout + whole.stderr
    service.end()
    # the end is announced in the log, which a change of the database does not reach
    assert f"audit head 4 {head['hash']}" in service.log.read_text()
    with sqlite3.connect(tmp_path / "soo.db") as connection:
        connection.execute("DROP TRIGGER audit_entry_no_DELETE")
        connection.execute("DELETE FROM audit_entry WHERE number = 4")
        connection.execute("UPDATE audit_head SET number = 3, hash = (SELECT hash FROM audit_entry WHERE number = 3)")
    connection.close()
    assert soo(*verify, environment=compiled_environment).returncode == 0
    broken = soo(*verify, "--log", str(service.log), environment=compiled_environment)
    assert (broken.returncode, "entry 4: announced" in broken.stdout) == (1, True), broken.stdout
    nothing = soo(
        "audit", "verify", "--database", f"sqlite:///{tmp_path / 'none.db'}", environment=compiled_environment
    )
    assert (nothing.returncode, (tmp_path / "none.db").exists()) == (2, False)


@pytest.fixture
def certificate(tmp_path: Path) -> tuple[Path, Path]:
    """A certificate of its own for 127.0.0.1, and its key."""
    certificate, key = tmp_path / "certificate.pem", tmp_path / "key.pem"
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    command += ["-days", "2", "-subj", "/CN=soo-test", "-addext", "subjectAltName=IP:127.0.0.1"]
    subprocess.run([*command, "-keyout", str(key), "-out", str(certificate)], check=True, capture_output=True)
    return certificate, key


def test_https_is_served_and_old_protocols_are_not(start_service, certificate):
    chain, key = certificate
    service = start_service("--port", "0", "--tls-certificate", str(chain), "--tls-key", str(key))
    announced = service.await_announcement()
    assert announced["api"].startswith("https://127.0.0.1:")
    trusting = ssl.create_default_context(cafile=str(chain))
    assert get(service.url + BASE, "a-key-for-tests-only", verify=trusting).status_code == 200
    with pytest.raises(httpx.ConnectError):
        get(service.url + BASE, "a-key-for-tests-only")
    with pytest.raises(httpx.HTTPError):
        get(service.url.replace("https", "http") + BASE, "a-key-for-tests-only")
    assert trusting.minimum_version >= ssl.TLSVersion.TLSv1_2
    old = ssl.create_default_context(cafile=str(chain))
    old.set_ciphers("ALL:@SECLEVEL=0")
    with pytest.warns(DeprecationWarning, match="TLSv1"):
        old.minimum_version, old.maximum_version = ssl.TLSVersion.TLSv1, ssl.TLSVersion.TLSv1_1
    with pytest.raises(httpx.HTTPError):
        get(service.url + BASE, "a-key-for-tests-only", verify=old)
    assert service.end()[0] == 0


@pytest.mark.parametrize("fault", ["no key", "no file", "other key", "encrypted key"])
def test_a_certificate_that_cannot_be_used_is_said(start_service, certificate, fault, tmp_path):
    chain, key = certificate
    arguments = ["--port", "0", "--tls-certificate", str(chain)]
    if fault == "no file":
        arguments += ["--tls-key", str(tmp_path / "none.pem")]
    elif fault == "other key":
        other = tmp_path / "other.pem"
        subprocess.run(["openssl", "genrsa", "-out", str(other), "2048"], check=True, capture_output=True)
        arguments += ["--tls-key", str(other)]
    elif fault == "encrypted key":
        packed = tmp_path / "packed.pem"
        command = ["openssl", "pkey", "-in", str(key), "-aes256", "-passout", "pass:word", "-out", str(packed)]
        subprocess.run(command, check=True, capture_output=True)
        arguments += ["--tls-key", str(packed)]
    service = start_service(*arguments)
    assert service.process.wait(60) == 2, service.written()
    assert "Traceback" not in service.written()
    assert ("go together" if fault == "no key" else "cannot use certificate") in service.written()
    assert not (tmp_path / "soo.db").exists()


def test_forwarded_addresses_are_believed_from_trusted_proxies_only(start_service, tmp_path):
    forwarded = {"X-Forwarded-For": "192.0.2.77", "Authorization": "Bearer wrong"}
    for trusted, seen in (("", "127.0.0.1"), ("127.0.0.0/8", "192.0.2.77")):
        service = start_service(
            "--port",
            "0",
            database=tmp_path / f"proxy-{seen}.db",
            environment={"SOO_BOOTSTRAP_KEY": "a-key-for-tests-only", "SOO_TRUSTED_PROXIES": trusted},
        )
        assert httpx.get(service.url + BASE, headers=forwarded, trust_env=False).status_code == 401
        with service.client() as client:
            rows = client.get("/api/v1/audit").json()["rows"]
        assert [row["address"] for row in rows] == [seen]
        service.end()


def test_a_proxy_that_is_everybody_is_refused(start_service):
    environment = {"SOO_BOOTSTRAP_KEY": "x", "SOO_TRUSTED_PROXIES": "*"}
    service = start_service("--port", "0", environment={**os.environ, **environment})
    assert service.process.wait(60) == 2
    assert "trusted_proxies" in service.written()


def test_a_stream_ends_when_its_key_is_revoked(start_service, spacecraft):
    service = start_service()
    with service.client() as client:
        client.post(BASE, json=spacecraft)
        made = client.post("/api/v1/keys", json={"name": "vera", "role": "viewer"}).json()
        url = f"{service.url}{BASE}/sim-1/stream"
        with (
            httpx.Client(trust_env=False, timeout=20) as reader,
            reader.stream("GET", url, headers=bearer(made["key"])) as stream,
        ):
            lines = stream.iter_lines()
            assert next(lines)
            assert client.delete(f"/api/v1/keys/{made['id']}").status_code == 204
            # anything that would have been sent ends it: a change of the spacecraft, or the heartbeat after 15 s
            client.patch(f"{BASE}/sim-1", json={"name": "N"})
            for _ in lines:
                pass
    assert "Traceback" not in service.written()
