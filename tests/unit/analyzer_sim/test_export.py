"""Export: the file holds what the table of the module says."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import analyzer_sim.export as export_module
from analyzer_sim.export import export_arrays, export_npz, run_export
from analyzer_sim.world.payload.user_noise import sweep_sigma_db
from analyzer_sim.world.scenario.events import SwitchOff
from analyzer_sim.world.scenario.scenario import Scenario
from analyzer_sim.world.world import World

SHORT = Scenario(
    "short",
    "for tests",
    quiet_h=4.0,
    alignment_h=0.75,
    operation_h=3.0,
    faults=(SwitchOff("off", ("c05",), (1.0, 1.0), (1.0, 1.0)),),
)


@cache
def world() -> World:
    return World(SHORT, 1)


@cache
def arrays() -> dict[str, Any]:
    return export_arrays(world())


def documented_keys() -> set[str]:
    """Read the keys from the table in the module's docstring, short forms written out."""
    text = (export_module.__doc__ or "").split("==\n")
    keys: set[str] = set()
    for line in text[2].splitlines():
        names = line.split("(")[0].replace(",", " ").split()
        for number, name in enumerate(names):
            whole = names[number - 1].replace("_start_us", "") + name if name.startswith("_") else name
            angles = ("yaw", "roll", "pitch") if "{angle}" in whole else ("",)
            keys |= {whole.replace("{angle}", angle) for angle in angles}
    return {key for key in keys if not key.startswith("=")}


def test_the_table_documents_exactly_the_keys() -> None:
    assert documented_keys() == set(arrays())


def test_shapes_agree() -> None:
    found = arrays()
    rows, carriers = found["power_dbm"].shape
    assert carriers == len(found["carrier_id"]) == 16
    for key in ("epoch_us", "yaw_deg", "roll_deg", "pitch_deg", "downlink_fade_db", "chain_db"):
        assert found[key].shape == (rows,)
    for key in ("uplink_fade_db", "flags"):
        assert found[key].shape == (rows, carriers)
    assert found["sensitivity_db_per_deg"].shape == (carriers, 3)
    assert len(found["turn_start_us"]) == len(found["turn_yaw_deg"]) == 32


def test_absent_powers_are_nan_and_flagged() -> None:
    found = arrays()
    off = dict(zip(found["flag_name"].tolist(), found["flag_value"].tolist(), strict=True))["off"]
    np.testing.assert_array_equal(np.isnan(found["power_dbm"]), (found["flags"] & off) != 0)
    assert int(np.isnan(found["power_dbm"]).sum()) == 60


def test_the_stand_in_has_the_sweeps_noise_and_can_be_left_out() -> None:
    clean = export_arrays(world(), sweep_noise=0.0)["power_dbm"]
    np.testing.assert_array_equal(clean, world().rows.power_dbm)
    added = arrays()["power_dbm"] - clean
    # some 970 rows: 2.3 % each, four sigmas
    np.testing.assert_allclose(np.nanstd(added, axis=0), sweep_sigma_db(world().plan), rtol=0.1)


def test_knowledge_is_that_of_the_world() -> None:
    found = arrays()
    assert found["reference_epoch_us"][-1] < SHORT.operation_start_us
    assert found["correction_start_us"].tolist() == [c.start_us for c in world().corrections]
    assert found["phase_name"].tolist() == ["quiet", "turns", "alignment", "operation"]
    kinds = [line["kind"] for line in json.loads(found["catalogue_json"])]
    assert kinds == ["spacecraft", "carriers", "task", "ephemeris", "bound"]


def test_the_file_reads_back_without_pickle(tmp_path: Path) -> None:
    path = tmp_path / "world.npz"
    export_npz(world(), path)
    with np.load(path, allow_pickle=False) as file:
        assert set(file.files) == set(arrays())
        np.testing.assert_array_equal(file["power_dbm"], arrays()["power_dbm"])


def test_run_export_writes_and_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "out.npz"
    assert run_export(replace(SHORT, faults=()), 7, path) == 0
    assert "seed 7" in capsys.readouterr().out
    assert path.stat().st_size > 10_000
