"""The page on production: a wheel is built and installed apart from the checkout, started, upgraded and rolled back.

The blocks run as they stand, below a folder of the test. Stand-ins: packages of the lock come from the environment of
the tests (``make`` installs them from the lock), programs of root and systemd are scripts of this file.
"""

import json
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from service_process import free_ports

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "how-to" / "install-for-production.md"
SITE = f"lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages"
SYSTEMCTL = """#!/usr/bin/env python3
# starts what the unit says, as its user would; one service, its process id in a file
import os, re, signal, subprocess, sys, time
unit, ran = open("{folder}/etc/systemd/system/soo.service").read(), "{folder}/pid"
word = sys.argv[1]
if word == "stop":
    number = int(open(ran).read())
    os.kill(number, signal.SIGTERM)
    while os.path.exists(f"/proc/{{number}}"):
        time.sleep(0.05)
elif word in ("start", "enable"):
    stated = dict(re.findall(r"^(\\w+)=(.*)$", unit, re.MULTILINE))
    shell = f"set -a; . {{stated['EnvironmentFile']}}; cd {{stated['WorkingDirectory']}}; exec {{stated['ExecStart']}}"
    log = open("{folder}/service.log", "ab")
    process = subprocess.Popen(["setsid", "bash", "-c", shell], stdout=log, stderr=log)
    open(ran, "w").write(str(process.pid))
"""
PROGRAMS = {"sudo": '#!/bin/sh\nshift 2\nexec "$@"\n', "useradd": "#!/bin/sh\n", "chown": "#!/bin/sh\n"}


class Machine:
    """Folder that stands for a server, with the stand-ins of its programs."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.release = folder, folder / "release"
        programs = folder / "programs"
        programs.mkdir()
        (folder / "etc/systemd/system").mkdir(parents=True)
        for name, text in {**PROGRAMS, "systemctl": SYSTEMCTL.format(folder=folder)}.items():
            (programs / name).write_text(text)
            (programs / name).chmod(0o755)
        kept = {name: value for name, value in os.environ.items() if not name.startswith(("SOO_", "PYTHON"))}
        path = f"{programs}{os.pathsep}{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        self.environment = {**kept, "PATH": path, "no_proxy": "127.0.0.1", "NUMBA_DISABLE_JIT": "1"}
        self.port = free_ports()

    def run(self, block: str) -> subprocess.CompletedProcess[str]:
        """Run a block of the page below the folder, with the stand-ins."""
        for place in ("/opt/soo", "/var/lib/soo", "/etc/systemd"):
            block = block.replace(place, f"{self.folder}{place}")
        # one release is there to be installed; it is started on a port that is free
        block = block.replace("soo-0.2.0-", "soo-0.1.0-").replace("127.0.0.1:8000", f"127.0.0.1:{self.port}")
        block = block.replace(" --no-profile", f" --no-profile --port {self.port}")
        packages = f"echo {Path(httpx.__file__).parents[1]} >\\1/{SITE}/locked.pth"
        block = re.sub(r"(\S+)/bin/pip install .* -r requirements.lock", packages, block)
        # compiling takes a minute; the service of the test runs the filter as Python
        block = re.sub(r"python -m (service.pipeline.first_rows)", r"python -c 'import \1'", block)
        command = ["bash", "-c", f"set -e\n{block}"]
        return subprocess.run(
            command, cwd=self.release, env=self.environment, capture_output=True, text=True, timeout=300
        )

    def stop(self) -> None:
        """End the service if it runs."""
        number = self.folder / "pid"
        if number.exists() and Path(f"/proc/{number.read_text()}").exists():
            os.kill(int(number.read_text()), signal.SIGKILL)


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[Machine]:
    """Give a machine with what ``make dist`` writes."""
    if shutil.which("make") is None or shutil.which("curl") is None:
        pytest.skip("make and curl are needed")
    made = Machine(tmp_path)
    # the environment of the tests is there already
    options = ["-o", ".venv/.installed-dev", f"BIN={Path(sys.executable).parent}", f"DIST={made.release}"]
    built = subprocess.run(["make", "dist", *options], cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert built.returncode == 0, built.stderr
    yield made
    made.stop()


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.nightly
def test_blocks_run_as_they_stand(machine: Machine) -> None:
    listing, install, user, unit, new, change_over, back, restore = re.findall(
        r"^```bash\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE
    )
    database = machine.folder / "var/lib/soo/soo.db"
    assert machine.run(listing).returncode == 0
    assert machine.run(install).stdout == "0.1.0\n"
    require_program_of_the_wheel(machine)
    done = machine.run(user)
    assert done.returncode == 0, done.stderr
    done = machine.run(unit)
    assert done.returncode == 0, done.stderr
    require_service_of_the_wheel(machine)
    for block, wanted in ((new, "before-0.2.0.backup"), (change_over, "layout")):
        done = machine.run(block)
        assert done.returncode in (0, 3), done.stderr
        assert wanted in done.stdout
    assert (machine.folder / "opt/soo/current").readlink() == Path("0.2.0")
    # as an archive of a release with another layout
    with sqlite3.connect(database) as newer:
        newer.execute("UPDATE archive_layout SET number = 9999")
    newer.close()
    done = machine.run(back)
    assert done.returncode == 1
    assert "9999" in done.stdout
    done = machine.run(restore)
    assert done.returncode == 0, done.stderr
    assert list(database.parent.glob("soo.db.before-*"))


def require_program_of_the_wheel(machine: Machine) -> None:
    """The installed program shows its help and flies the demonstration, from a folder that is no checkout."""
    shown = machine.run("/opt/soo/current/bin/soo --help")
    assert "demo" in shown.stdout
    found = machine.run("/opt/soo/current/bin/python -c 'import service; print(service.__file__)'")
    assert found.stdout.startswith(f"{machine.folder}/opt/soo/current/lib"), found.stdout
    flown = machine.run("/opt/soo/current/bin/soo demo --exit --json --days 0.05 --quiet-days 0.5")
    assert flown.stderr == ""
    figures = json.loads(flown.stdout)
    assert (figures["rows"], figures["rows_lost"], figures["replay_rows_different"]) == (72, 0, 0)


def require_service_of_the_wheel(machine: Machine) -> None:
    """The unit serves the console with its words, the archive is made, its key opens it."""
    key = (machine.folder / "var/lib/soo/administrator.key").read_text().strip()
    with httpx.Client(base_url=f"http://127.0.0.1:{machine.port}", timeout=60, trust_env=False) as client:
        assert "<title>" in client.get("/console/").text
        for name in ("app.js", "words/en.json", "words/ru.json", "views/now.js", "css/tokens.css"):
            assert client.get(f"/console/{name}").status_code == 200, name
        about = client.get("/api/v1/session", headers={"Authorization": f"Bearer {key}"})
        assert about.json()["role"] == "admin"
