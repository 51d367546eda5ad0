"""Command line of the simulator."""

import socket
from pathlib import Path

import numpy as np
import pytest

from analyzer_sim.__main__ import build_parser, main
from analyzer_sim.instrument.trace_faults import TraceFault, TraceFaults
from analyzer_sim.lines.line_faults import LineFault, LineFaults
from analyzer_sim.serving import FAULT_NAMES, arm


def test_serve_has_the_documented_defaults() -> None:
    options = build_parser().parse_args(["serve"])
    assert (options.dialect, options.port, options.ground_port) == ("rs", 5025, 5026)
    assert (options.scenario, options.seed, options.host, options.detail) == ("demo", 1, "127.0.0.1", "fast")
    assert not options.await_ground
    assert (options.uplink_port, options.uplink, options.onboard) == (None, "ideal", "wheels")
    assert (options.hislip_port, options.alias_port, options.pace, options.truth_log, options.fault) == (
        None,
        [],
        "virtual",
        None,
        [],
    )


@pytest.mark.parametrize(
    "arguments",
    [
        ["--port", "70000"],
        ["--port", "x"],
        ["--seed", "-1"],
        ["--scenario", "none"],
        ["--start", "2026-11-01T00:00:00"],
        ["--start", "yesterday"],
        ["--operation-days", "nan"],
        ["--operation-days", "-1"],
        ["--quiet-days", "0"],
        ["--scenario", "slew_fade"],
        ["--uplink-port", "-1"],
        ["--uplink", "none"],
        ["--dialect", "klingon"],
        ["--pace", "slow"],
        ["--hislip-port", "-1"],
        ["--fault", "none"],
        ["--fault", "nan:0"],
        ["--fault", "nan:1001"],
        ["--fault", "nan:x"],
        ["export"],
    ],
)
def test_wrong_option_ends_with_two_and_says_why(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert "error:" in capsys.readouterr().err


def test_export_writes_the_scenario(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "world.npz"
    assert main(["export", "--scenario", "white", "--seed", "4", "--operation-days", "0.05", "--out", str(out)]) == 0
    assert "white" in capsys.readouterr().out
    with np.load(out) as arrays:
        assert arrays["power_dbm"].shape == (len(arrays["epoch_us"]), len(arrays["carrier_id"]))
        assert int(arrays["seed"]) == 4


@pytest.mark.parametrize("option", ["--port", "--alias-port", "--hislip-port", "--ground-port", "--uplink-port"])
def test_port_in_use_is_told_without_a_traceback(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        free = [word for name in ("--port", "--ground-port") if name != option for word in (name, "0")]
        assert main(["--operation-days", "0.05", *free, option, port]) == 1
    reported = capsys.readouterr()
    assert reported.out == ""
    assert reported.err.startswith("soo-analyzer: ")
    assert reported.err.endswith(f" port {port} of 127.0.0.1: address already in use\n")


def test_truth_log_that_cannot_be_written_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "none" / "truth.jsonl"
    assert main(["--operation-days", "0.05", "--port", "0", "--ground-port", "0", "--truth-log", str(log)]) == 1
    assert "No such file or directory" in capsys.readouterr().err


def test_faults_of_the_command_line_are_armed_in_their_place() -> None:
    options = build_parser().parse_args(["serve", "--fault", "stale:2", "--fault", "nan:3", "--fault", "silent_peer"])
    line, trace = LineFaults(), TraceFaults()
    arm(options.fault, line, trace)
    assert (line.remaining, trace.remaining, line.is_silent_peer) == (2, 3, True)
    line.disarm()
    assert (line.remaining, line.is_silent_peer) == (0, False)


def test_every_fault_has_a_name_of_its_own() -> None:
    assert len(set(FAULT_NAMES)) == len(FAULT_NAMES) == 1 + len(LineFault) + len(TraceFault)
