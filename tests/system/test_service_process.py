"""The service as a process: how it starts, serves, ends, and what its start costs."""

import os
import re
import socket
import statistics
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlsplit

import chaos_clients as chaos
import httpx
import pytest
from waiting import wait_until

pytestmark = pytest.mark.system


KEY = "a-key-for-tests-only"
BASE = "/api/v1/spacecraft"


def rows(first_s: int, count: int) -> list[dict]:
    """Return rows a second apart, that differ from one another."""
    return [
        {
            "epoch": f"2026-11-21T03:{second // 60:02d}:{second % 60:02d}.000000Z",
            "power_dbm": [-40.0 - second / 64] * 16,
        }
        for second in range(first_s, first_s + count)
    ]


def test_it_announces_its_address_once_is_ready_never_writes_the_given_key_and_ends_by_sigint(start_service):
    service = start_service()
    announced = service.await_announcement()
    assert announced["url"].startswith("http://127.0.0.1:")
    assert announced["api"] == announced["url"] + "/api/v1"
    with service.client() as client:
        assert client.get("/readyz").status_code == 200
        assert client.get(BASE).status_code == 200
        assert client.get(BASE, headers={"Authorization": "Bearer another-key-than-ours"}).status_code == 401
        client.get("/api/v1/nothing-here")
    assert len(service.output.read_text().splitlines()) == 1
    assert service.end(2)[0] == 0
    written = service.written()
    assert [text for text in (KEY, "another-key-than-ours", "Traceback") if text in written] == []


@pytest.mark.slow
def test_no_answer_lets_a_browser_guess_its_type(start_service):
    service = start_service(environment={"SOO_BOOTSTRAP_KEY": KEY, "SOO_ALLOWED_ORIGINS": "https://elsewhere.test"})
    address = urlsplit(service.await_announcement()["url"])

    def answer(request):
        with socket.create_connection((address.hostname, address.port), 30) as client:
            client.sendall(request.encode() + b"\r\nHost: soo\r\nConnection: close\r\n\r\n")
            head = b"".join(iter(lambda: client.recv(65536), b"")).partition(b"\r\n\r\n")[0].decode().lower()
        assert head.count("x-content-type-options: nosniff") == 1, head
        return int(head.split()[1])

    paths = {"/healthz": 200, "/metrics": 200, "/console/": 200, "/openapi.json": 200, "/nothing": 404, BASE: 401}
    assert {path: answer(f"GET {path} HTTP/1.1") for path in paths} == paths
    asking = "Origin: https://elsewhere.test\r\nAccess-Control-Request-Method: GET"
    assert answer(f"OPTIONS {BASE} HTTP/1.1\r\n{asking}") == 200
    # outside of the application
    assert answer("GET / HTTP/1.1\r\nno header") == 400
    assert answer(f"GET / HTTP/1.1\r\nX: {'x' * 70_000}") == 431


@pytest.mark.slow
def test_a_browser_at_two_services_of_one_host_is_signed_in_and_out_at_each_by_itself(start_service, tmp_path):
    services = [start_service(database=tmp_path / name) for name in ("one.db", "two.db")]
    one, two = (f"{service.await_announcement()['url']}/api/v1/session" for service in services)
    # as in a browser, ports share their cookies
    with httpx.Client(timeout=60.0, trust_env=False) as browser:

        def holders():
            return [browser.get(url).status_code for url in (one, two)]

        assert holders() == [401, 401]
        for url, expected in ((one, [200, 401]), (two, [200, 200])):
            assert browser.post(url, json={"key": KEY}).status_code == 200
            assert holders() == expected
        tokens = dict(browser.cookies)
        assert len(tokens) == 2
        assert KEY not in str(tokens)
        # each receives the other's token, which opens nothing there
        crossed = dict(zip(tokens, reversed(tokens.values()), strict=True))
        cookie = "; ".join(f"{name}={token}" for name, token in crossed.items())
        assert [httpx.get(url, headers={"Cookie": cookie}).status_code for url in (one, two)] == [401, 401]
        assert browser.delete(one, headers={"Origin": one.removesuffix("/api/v1/session")}).status_code == 204
        assert holders() == [401, 200]
        # a copy of the cookie
        kept = "; ".join(f"{name}={token}" for name, token in tokens.items())
        assert httpx.get(one, headers={"Cookie": kept}).status_code == 401


@pytest.mark.slow
def test_sigterm_ends_it_at_once_beside_open_streams_and_idle_connections(start_service, spacecraft, carriers):
    service = start_service()
    with service.client() as client, service.client() as streaming:
        chaos.set_up(client, spacecraft, carriers)
        with streaming.stream("GET", f"{BASE}/sim-1/stream") as stream:
            assert stream.status_code == 200
            lines = stream.iter_lines()
            assert next(line for line in lines if line.startswith("event:")) == "event: status"
            # the other connection was used and is kept alive
            code, _ = service.end()
    assert code == 0, service.written()
    assert "Traceback" not in service.written()


def test_a_signal_during_the_start_ends_it_without_a_trace(start_service, tmp_path):
    service = start_service(database=tmp_path / "soo.db")
    # the interpreter has installed the handlers, the database is perhaps being made
    wait_until((service.output.parent / "soo.db").exists)
    code, _ = service.end()
    assert code == 0, service.written()
    assert "Traceback" not in service.written()


@pytest.mark.slow
def test_a_second_start_on_the_same_database_knows_everything(start_service, spacecraft, carriers, tmp_path):
    # the first one makes the database
    service = start_service(database=tmp_path / "soo.db")
    with service.client() as client:
        plan_id = chaos.set_up(client, spacecraft, carriers)
        body = {"plan_id": plan_id, "source": "sa-1", "first_seq": 1, "measurements": rows(0, 90)}
        sent = client.post(f"{BASE}/sim-1/measurements:batch", json=body).json()
        assert (sent["received"], sent["accepted"], sent["durable"]) == (90, 90, True)
        window = {"start": "2026-11-21T00:00:00Z", "stop": "2026-11-22T00:00:00Z", "limit": 1000}
        before = client.get(f"{BASE}/sim-1/measurements/history", params=window).json()
        known = client.get(f"{BASE}/sim-1").json()
    assert service.end()[0] == 0
    again = start_service()
    with again.client() as client:
        assert client.get(f"{BASE}/sim-1").json() == known
        assert client.get(f"{BASE}/sim-1/carriers").json()["plan_id"] == plan_id
        assert client.get(f"{BASE}/sim-1/measurements/history", params=window).json() == before
        assert len(before["rows"]) == 90
        repeated = client.post(f"{BASE}/sim-1/measurements:batch", json=body).json()
        assert (repeated["accepted"], repeated["duplicates"]) == (0, 90)
    assert again.end()[0] == 0


def test_a_port_in_use_is_said_and_ends_with_code_two(start_service, tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        service = start_service("--port", str(port), database=tmp_path / "other.db")
        assert service.process.wait(120) == 2
    assert f"cannot listen on 127.0.0.1:{port}" in service.written()
    assert "Traceback" not in service.written()
    assert service.output.read_text() == ""


CANNOT_BE = {
    ("--clock", "moon"): "clock",
    ("--port", "123456"): "port",
    ("--database", "sqlite://"): "in-memory",
    ("--database", "soo.db"): "URL cannot be read",
    ("--database", "oracle://x/y"): "oracle",
    ("--database", "sqlite:////nowhere/at/all/soo.db"): "unable to open database",
    ("--host", "no.such.host.invalid"): "cannot listen",
    ("--no-http",): "--no-http is for estimators beside services on a PostgreSQL server",
    ("--no-http", "--no-estimator", "--database", "postgresql+psycopg://x@/y"): "has nothing to do",
}


@pytest.mark.slow
def test_what_cannot_be_served_is_said_and_ends_with_code_two(refused_starts, tmp_path):
    # what a test does not name could be served
    others = ["--port", "0", "--database", f"sqlite:///{tmp_path / 'soo.db'}"]
    ended = refused_starts(*(([*others, *arguments], {}) for arguments in CANNOT_BE))
    for (code, output), (arguments, said) in zip(ended, CANNOT_BE.items(), strict=True):
        assert (code, said in output) == (2, True), (arguments, code, output)


#: each costs a tenth of a second and more, or ten megabytes and more
COSTLY = ("pyarrow", "matplotlib", "scipy", "numba", "prometheus_client", "httpx", "skyfield", "pyvisa")
MAX_RSS_MB = 225.0
#: modules that no command needs before it begins its work
WORKING = (*COSTLY, "numpy", "pydantic_settings", "fastapi", "sqlalchemy", "rich", "ssl", "sqlite3", "asyncio")
#: processor time of a start over that of ``import typer``; typer itself, which reads options by pydantic, takes 2.4
MAX_START_RATIO = 3.0
STARTS = (
    "service --help",
    "service serve --help",
    "service demo --help",
    "service acquire --help",
    "service keys list --service none",
    "service audit verify --help",
    "service study closed-loop --help",
    "analyzer_sim --help",
)
_RUNS = 7
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def test_costly_modules_are_not_loaded_by_a_service_without_work():
    code = (
        "import sys; import service.__main__, service.composition.bootstrap, service.cli.administration.server;"
        "import service.api.server_process;"
        f"print(*[name for name in {COSTLY!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.split() == []


def test_no_command_loads_what_it_works_with_before_it_begins():
    code = (
        "import sys, typer, service.__main__, analyzer_sim.__main__\n"
        "from service.cli.app import app\n"
        "def walk(group):\n"
        "    for command in group.commands.values():\n"
        "        walk(command) if hasattr(command, 'commands') else print(command.name)\n"
        "walk(typer.main.get_command(app))\n"
        f"print(*[name for name in {WORKING!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    *names, loaded = done.stdout.splitlines()
    assert len(names) > 20
    assert loaded == ""


def processor_s(*arguments):
    """Return the processor time of an interpreter with these arguments."""
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "stdin": subprocess.DEVNULL}
    # without a key an operator's command ends before it asks the service
    environment = {name: value for name, value in os.environ.items() if not name.startswith("SOO_")}
    process = subprocess.Popen([sys.executable, *arguments], env=environment, **silent)
    _, _, usage = os.wait4(process.pid, 0)
    process.returncode = 0
    return usage.ru_utime + usage.ru_stime


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "wait4"), reason="the system does not tell what a process took")
def test_a_command_starts_in_three_times_the_import_of_typer():
    taken = {words: [] for words in STARTS}
    reference = []
    for _ in range(_RUNS):
        reference.append(processor_s("-c", "import typer"))
        for words, times in taken.items():
            times.append(processor_s("-m", *words.split()))
    typer_s = statistics.median(reference)
    ratios = {words: statistics.median(times) / typer_s for words, times in taken.items()}
    for words, ratio in ratios.items():
        print(f"{ratio:.2f} {words}")
    assert max(ratios.values()) <= MAX_START_RATIO


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="the system does not tell what a process takes")
def test_start_and_idle_service_stay_small(start_service):
    # on a database that is there already
    service = start_service()
    with service.client() as client:
        assert client.get("/readyz").status_code == 200
        pid = service.process.pid
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        cpu_s = (int(fields[11]) + int(fields[12])) / _TICKS_PER_S
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        rss_mb = int(next(line.split()[1] for line in lines if line.startswith("VmRSS"))) / 1024
    print(f"{cpu_s:.2f} s of processor time, {rss_mb:.0f} MB")
    assert rss_mb < MAX_RSS_MB


PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "use-the-python-client.md"


@pytest.mark.slow
def test_examples_do_what_they_claim(start_service):
    examples = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    assert len(examples) >= 5
    assert all("assert" in example for example in examples), "an example that claims nothing proves nothing"
    service = start_service()
    names = {"URL": service.url, "KEY": KEY}
    for example in examples:
        exec(compile(example, PAGE.name, "exec"), names)  # noqa: S102 - our own page
    assert service.end()[0] == 0
