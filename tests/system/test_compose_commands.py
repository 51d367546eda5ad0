"""What docker-compose.yml and the Dockerfile start, as processes on 127.0.0.1: twice, on the same data."""

import json
import re
import shlex
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx
import pytest
import yaml
from service_process import free_ports

pytestmark = [pytest.mark.system, pytest.mark.slow]

ROOT = Path(__file__).resolve().parents[2]
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
IMAGE = re.sub(r"\\\n\s*", "", (ROOT / "Dockerfile").read_text()).splitlines()
MODULES = {"soo": "service", "soo-analyzer": "analyzer_sim"}
KEY = "a-key-for-tests-only"
#: the machine may be busy with other tests
PATIENCE_S = 300.0


def instruction(name):
    """Return what the last instruction of a kind says."""
    return next(line.removeprefix(f"{name} ") for line in reversed(IMAGE) if line.startswith(f"{name} "))


def command_of(name):
    """Return the command of a service, that of the image where it states none."""
    return COMPOSE["services"][name].get("command") or json.loads(instruction("CMD"))


def health_check_of(name):
    """Return the check of a service, that of the image where it states none; None: it has none."""
    stated = COMPOSE["services"][name]["healthcheck"]
    if stated.get("disable"):
        return None
    if "test" in stated:
        assert stated["test"][0] == "CMD"
        return stated["test"][1:]
    return json.loads(instruction("HEALTHCHECK").partition("CMD ")[2])


class Host:
    """One host: its volume, its secrets, and a free port for each that is named."""

    def __init__(self, folder):
        self.data, self.secrets = folder / "data", folder / "secrets"
        for each in (self.data, self.secrets):
            each.mkdir()
        (self.secrets / "soo_bootstrap_key").write_text(f"{KEY}\n")
        first = free_ports(3)
        self.ports = {port: str(first + place) for place, port in enumerate(("8000", "5025", "5026"))}
        self.url = f"http://127.0.0.1:{self.ports['8000']}"

    def here(self, text):
        """Return a word of a command or of the environment as it is on this host."""
        for there, position in (("/run/secrets", self.secrets), ("////data", f"///{self.data}")):
            text = text.replace(there, str(position))
        text = re.sub(r"\b(service|analyzer):(?=\d)", "127.0.0.1:", text.replace("0.0.0.0", "127.0.0.1"))  # noqa: S104
        return re.sub(r"(?<!\d)(8000|5025|5026)(?!\d)", lambda port: self.ports[port[0]], text)

    def argv(self, command):
        program, *rest = map(self.here, command)
        return [sys.executable, *(["-m", MODULES[program]] if program in MODULES else []), *rest]

    @contextmanager
    def up(self, environment, log_folder):
        """Start every service after those that it depends on are well; end them as `down` does."""
        log_folder.mkdir()
        with ExitStack() as stack:
            for name in ("service", "analyzer", "demonstration"):
                given = COMPOSE["services"][name].get("environment", {})
                whole = {**environment, **{key: self.here(value) for key, value in given.items()}}
                log = stack.enter_context((log_folder / name).open("wb"))
                process = subprocess.Popen(self.argv(command_of(name)), env=whole, stdout=log, stderr=log, cwd=ROOT)
                stack.callback(self.end, process)
                if (check := health_check_of(name)) is not None:
                    self.await_health(process, check, log_folder / name)
            yield process

    def await_health(self, process, check, log):
        until = time.monotonic() + PATIENCE_S
        while subprocess.run(self.argv(check), capture_output=True, check=False).returncode:
            assert process.poll() is None, log.read_text()
            assert time.monotonic() < until, log.read_text()
            time.sleep(0.2)

    @staticmethod
    def end(process):
        process.terminate()
        process.wait(PATIENCE_S)


def test_up_twice_on_the_same_data_shows_the_story_twice(compiled_environment, tmp_path):
    host = Host(tmp_path)
    environment = {name: value for name, value in compiled_environment.items() if not name.startswith("SOO_")}
    environment |= {"PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)}
    seen = set()
    for turn in range(2):
        with host.up(environment, tmp_path / f"log-{turn}") as demonstration:
            fresh = await_rows(host, demonstration, seen, tmp_path / f"log-{turn}" / "demonstration")
        seen.add(fresh)
        # ended by a signal, as `docker compose down` does
        assert demonstration.returncode == 0, (tmp_path / f"log-{turn}" / "demonstration").read_text()
    assert len(seen) == 2
    assert (host.data / "soo.db").stat().st_mode & 0o777 == 0o600


def await_rows(host, demonstration, seen, log):
    """Return the spacecraft that is new, once it has rows."""
    base, headers = f"{host.url}/api/v1/spacecraft", {"Authorization": f"Bearer {KEY}"}
    until = time.monotonic() + PATIENCE_S
    with httpx.Client(headers=headers, trust_env=False, timeout=PATIENCE_S) as client:
        while time.monotonic() < until:
            assert demonstration.poll() is None, log.read_text()
            found = {row["id"] for row in client.get(base).json()["rows"]} - seen
            for name in found:
                if client.get(f"{base}/{name}/status").json()["newest_measurement"]:
                    return name
            time.sleep(0.2)
    raise AssertionError(log.read_text())


def test_services_restart_are_watched_and_hold_no_secret():
    assert set(COMPOSE["services"]) == {"service", "analyzer", "demonstration"}
    for name, service in COMPOSE["services"].items():
        assert "restart" in service, name
        assert "healthcheck" in service, name
        assert not any(re.search("KEY$|PASSWORD|SECRET$", key) for key in service.get("environment", {})), name
    assert {COMPOSE["services"][name]["restart"] for name in ("service", "analyzer")} == {"unless-stopped"}
    assert COMPOSE["secrets"] == {"soo_bootstrap_key": {"file": "./secrets/soo_bootstrap_key"}}
    for ignored in (".gitignore", ".dockerignore"):
        assert "secrets" in (ROOT / ignored).read_text().replace("/", "").splitlines()


def test_the_image_names_its_base_exactly_and_what_it_runs():
    assert re.fullmatch(r"python:3\.11\.\d+-slim-[a-z]+@sha256:[0-9a-f]{64}", instruction("FROM"))
    assert instruction("USER") == "soo"
    assert json.loads(instruction("CMD"))[:2] == ["soo", "serve"]
    assert "/readyz" in instruction("HEALTHCHECK")
    assert shlex.split(instruction("COPY"))


def test_a_secret_that_cannot_be_read_ends_the_start(compiled_environment, tmp_path):
    (tmp_path / "soo_bootstrap_key").write_bytes(b"\xff\xfe")
    environment = {**compiled_environment, "SOO_SECRETS_DIR": str(tmp_path)}
    command = [sys.executable, "-m", "service", "serve", "--port", "0"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("settings cannot be read")
