"""Command line of the simulator."""

from pathlib import Path

import numpy as np
import pytest

from analyzer_sim.__main__ import build_parser, main


def test_serve_has_the_documented_defaults() -> None:
    options = build_parser().parse_args(["serve"])
    assert (options.dialect, options.port, options.ground_port) == ("rs", 5025, 5026)
    assert (options.scenario, options.seed, options.host, options.detail) == ("demo", 1, "127.0.0.1", "fast")
    assert not options.await_ground


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
        ["--dialect", "klingon"],
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


def test_port_in_use_is_told_without_a_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    import socket

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert main(["--port", port, "--ground-port", "0", "--operation-days", "0.05"]) == 1
    assert "address already in use" in capsys.readouterr().err
