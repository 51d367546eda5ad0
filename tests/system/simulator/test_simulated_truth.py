"""Rows that reached a service over HiSLIP against the simulator's truth: counted, and compared carrier by carrier."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recording_service import Recorder

from analyzer_sim.world.ground import ground
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World

pytestmark = pytest.mark.system

SEED = 20261122
ROWS = 60
WORLD = ["--scenario", "nominal", "--seed", str(SEED), "--operation-days", "0.1"]


def simulator(log: Path, environment: dict[str, str]) -> tuple[subprocess.Popen[str], dict[str, Any]]:
    command = [sys.executable, "-m", "analyzer_sim", *WORLD, "--port", "0", "--ground-port", "0", "--hislip-port", "0"]
    process = subprocess.Popen(
        [*command, "--ideal", "--truth-log", str(log)], stdout=subprocess.PIPE, text=True, env=environment
    )
    assert process.stdout is not None
    return process, json.loads(process.stdout.readline())


def front_end(
    folder: Path, ports: dict[str, Any], service_port: int, environment: dict[str, str]
) -> subprocess.Popen[str]:
    resource = f"TCPIP::127.0.0.1::hislip0,{ports['hislip_port']}::INSTR"
    command = [sys.executable, "-m", "service", "acquire", "--task", str(folder / "task.json"), "--resource", resource]
    command += ["--spacecraft", "sc", "--service", f"http://127.0.0.1:{service_port}", "--epoch", "analyzer"]
    command += ["--period", "0", "--spool", str(folder / "spool")]
    return subprocess.Popen(command, env=environment | {"SOO_KEY": "key"}, stderr=subprocess.PIPE, text=True)


def test_every_trace_that_left_is_a_row_and_every_row_is_true(
    tmp_path: Path, compiled_environment: dict[str, str]
) -> None:
    print(f"seed {SEED}")
    world = World(scenario_named("nominal", operation_days=0.1), SEED)
    (tmp_path / "task.json").write_text(json.dumps(ground.task(world, world.plan_versions[0].carriers)))
    environment = os.environ | compiled_environment
    recorder = Recorder(list(world.carrier_ids))
    recorder.start()
    sim, ports = simulator(tmp_path / "truth.jsonl", environment)
    acquire = front_end(tmp_path, ports, recorder.port, environment)
    try:
        deadline_s = time.monotonic() + 120.0
        while len(recorder.rows) < ROWS and time.monotonic() < deadline_s and acquire.poll() is None:
            time.sleep(0.02)
        acquire.send_signal(signal.SIGTERM)
        _, said = acquire.communicate(timeout=120.0)
        assert acquire.returncode == 0, said
    finally:
        acquire.kill()
        sim.kill()
        sim.communicate()
        recorder.stop()
    lines = [json.loads(text) for text in (tmp_path / "truth.jsonl").read_text().splitlines()]
    sweeps = {line["sweep"]: line for line in lines if line["kind"] == "sweep"}
    traces = [line for line in lines if line["kind"] == "trace"]
    assert len(recorder.rows) >= ROWS, said
    assert sorted(recorder.rows) == sorted({line["epoch"] for line in traces}), "neither lost nor doubled nor made up"
    truth = {line["epoch"]: list(sweeps[line["sweep"]]["power_dbm"].values()) for line in traces}
    epochs = sorted(recorder.rows)
    measured_dbm = np.array([recorder.rows[epoch]["power_dbm"] for epoch in epochs], dtype=float)
    error_db = measured_dbm - np.array([truth[epoch] for epoch in epochs], dtype=float)
    # seen: .07 to .12 dB for one sweep, the mean of each carrier within .02 dB; four times the error of a mean allowed
    assert np.nanstd(error_db) < 0.15
    assert np.max(np.abs(np.nanmean(error_db, axis=0))) < 0.05
