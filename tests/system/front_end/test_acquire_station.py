"""A station file with analyzers of two makes: both are measured, reported, and rest when an operator says so."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from analyzer_thread import AnalyzerThread, start_in_thread
from steady_world import CARRIERS, Steady, steady_task

from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.instrument.imperfections import IDEAL
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import Detail, TracePainter
from service.frontend.spool.spool import spool_path

pytestmark = pytest.mark.system

SEED = 3
KEY = "a-key-for-tests-only"
PERIOD_S = 0.25
REPORT_S = 0.4


def analyzer(dialect: str) -> AnalyzerThread:
    """Return a simulated analyzer of one make."""
    spoken = DIALECTS[dialect]
    instrument = Instrument(Steady(), TracePainter(SEED, IDEAL, Detail.FAST), model=spoken.model)
    return start_in_thread(instrument, dialect=spoken, hislip_port=0)


@contextmanager
def station(folder: Path, url: str) -> Iterator[subprocess.Popen[str]]:
    """Run ``soo acquire`` with a Keysight over HiSLIP and a Siglent over a socket."""
    with ExitStack() as stack:
        keysight, siglent = (stack.enter_context(analyzer(name)) for name in ("keysight", "siglent"))
        resources = {
            "sa-1": f"TCPIP::127.0.0.1::hislip0,{keysight.hislip_port}::INSTR",
            "sa-2": f"TCPIP::127.0.0.1::{siglent.port}::SOCKET",
        }
        (folder / "task.json").write_text(steady_task(time_s=0.1).model_dump_json())
        entries = [
            {"task": "task.json", "spacecraft": "sim-1", "source": source, "resource": resource, "period_s": PERIOD_S}
            for source, resource in resources.items()
        ]
        (folder / "station.json").write_text(json.dumps(entries))
        command = [sys.executable, "-m", "service", "acquire", "--station", str(folder / "station.json")]
        command += ["--service", url, "--report-s", str(REPORT_S), "--spool", str(folder / "spool"), "--json-log"]
        log = stack.enter_context((folder / "acquire.log").open("w"))
        process = subprocess.Popen(command, env=os.environ | {"SOO_KEY": KEY}, stderr=log, text=True)
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()


def wait_until(is_true: Callable[[], Any], what: str, patience_s: float = 120.0) -> Any:
    """Wait, in small steps, until something is true, and return it."""
    deadline = time.monotonic() + patience_s
    while not (found := is_true()):
        assert time.monotonic() < deadline, f"waited {patience_s} s for {what}"
        time.sleep(0.05)
    return found


def link(client: httpx.Client, name: str) -> dict[str, Any]:
    """Return a link as operators see it; empty when it has not reported."""
    links = client.get("/api/v1/links").raise_for_status().json()["links"]
    return next((each for each in links if each["id"] == name), {})


def test_a_station_of_two_makes(
    start_service: Callable[..., Any], spacecraft: dict[str, Any], carriers: list[dict[str, Any]], tmp_path: Path
) -> None:
    service = start_service()
    with service.client() as client:
        client.post("/api/v1/spacecraft", json=spacecraft).raise_for_status()
        plan = [carrier | {"id": name} for carrier, name in zip(carriers, CARRIERS, strict=False)]
        client.put("/api/v1/spacecraft/sim-1/carriers", json={"carriers": plan}).raise_for_status()
    with service.client() as client, station(tmp_path, service.url) as process:

        def accepted(name: str, rows: int = 3) -> bool:
            return int(link(client, name).get("counters", {}).get("accepted", 0)) >= rows

        for name in ("sim-1.sa-1", "sim-1.sa-2"):
            wait_until(lambda name=name: accepted(name), f"rows of {name}")
        shown = link(client, "sim-1.sa-1")
        assert (shown["state"], shown["kind"], shown["source"]) == ("MEASURE", "analyzer", "sa-1")
        assert "keysight" in shown["detail"]["analyzer"]
        assert shown["last_good"] is not None
        # the Siglent's 751 points lie too far apart for this task's RBW, which the front end finds out by itself
        assert "sweep.points" in [each["code"] for each in link(client, "sim-1.sa-2")["warnings"]]

        client.post("/api/v1/links/sim-1.sa-1:disable").raise_for_status()
        wait_until(lambda: link(client, "sim-1.sa-1")["state"] == "DISABLED", "the link to rest")
        resting, going = (link(client, name)["counters"]["rows"] for name in ("sim-1.sa-1", "sim-1.sa-2"))
        wait_until(lambda: link(client, "sim-1.sa-2")["counters"]["rows"] >= going + 4, "the other one to go on")
        assert link(client, "sim-1.sa-1")["counters"]["rows"] == resting
        client.post("/api/v1/links/sim-1.sa-1:enable").raise_for_status()
        client.post("/api/v1/links/sim-1.sa-2:reset").raise_for_status()
        wait_until(lambda: link(client, "sim-1.sa-1")["counters"]["rows"] > resting, "the link to go on")
        reset = wait_until(lambda: link(client, "sim-1.sa-2")["counters"]["resets"] == 1, "the reset")
        assert reset
        assert link(client, "sim-1.sa-2")["counters"]["rows"] > going

        process.send_signal(signal.SIGTERM)
        assert process.wait(120.0) == 0, (tmp_path / "acquire.log").read_text()
    assert all(spool_path(tmp_path / "spool", "sim-1", source).exists() for source in ("sa-1", "sa-2"))


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run ``soo acquire`` to its end."""
    command = [sys.executable, "-m", "service", "acquire", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120.0, check=False)


def test_the_plan_is_shown_and_checked_without_analyzer_key_or_service(tmp_path: Path) -> None:
    document = json.loads(steady_task().model_dump_json())
    document["task"]["zoom"] = "auto"
    document["task"]["analyzer"]["resource"] = "TCPIP::nowhere::5025::SOCKET"
    document["carriers"][0] |= {"symbol_rate": 200e3, "integ_bw_hz": 250e3, "limits": {"sigma_goal_db": 0.15}}
    (tmp_path / "task.json").write_text(json.dumps(document))
    shown = run("--task", str(tmp_path / "task.json"), "--spacecraft", "sc", "--check")
    assert shown.returncode == 0, shown.stderr
    assert "strong.zoom" in shown.stderr
    document["task"]["zoom"] = "off"
    document["carriers"][0]["symbol_rate"] = 100e3
    (tmp_path / "task.json").write_text(json.dumps(document))
    refused = run("--task", str(tmp_path / "task.json"), "--spacecraft", "sc", "--check", "--json-log")
    assert refused.returncode == 2
    assert "rbw.too_wide: strong" in refused.stderr
