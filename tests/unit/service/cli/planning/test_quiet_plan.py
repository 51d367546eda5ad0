"""``soo plan --quiet``: the report of quiet days of the simulator, and files that a mistaken user would send."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from foreign_station import ZONE, write_station
from plan_files import write_plan_files, write_powers
from typer.testing import CliRunner

from service.cli.own_data.carriers import read_plan
from service.cli.own_data.importing.manifest import write_manifest
from service.cli.planning.plan import plan
from service.cli.planning.quiet_files import read_powers
from service.records.catalogue import CarrierPlan
from service.records.levels.series import MeasurementSeries
from service.study.estimation.flight.world import World, export_world, read_world

HOUR_US = 3_600_000_000
#: every fifth row: what is tested here does not need the others
STEP = 5


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    path = tmp_path_factory.mktemp("world") / "world.npz"
    export_world("nominal", 1, path, 0.05)
    return read_world(path)


def powers(world: World, window: str = "quiet") -> MeasurementSeries:
    ground = world.ground
    series = ground.series(ground.phases[window], tuple(carrier.id for carrier in ground.carriers))
    return MeasurementSeries(series.carrier_ids, series.epochs_us[::STEP], series.power_dbm[::STEP])


@pytest.fixture
def options(world: World, tmp_path: Path) -> list[str]:
    found = write_plan_files(world, tmp_path)
    write_powers(tmp_path / "quiet.csv", powers(world))
    return found


def run(*options: str) -> Any:
    app = typer.Typer()
    app.command()(plan)
    return CliRunner().invoke(app, list(options))


def test_the_report_of_quiet_days(options: list[str], tmp_path: Path) -> None:
    folder = tmp_path / "report"
    result = run(*options, "--report", str(folder), "--json")
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert json.loads((folder / "plan.json").read_text()) == document
    quiet = document["quiet"]
    assert quiet["works"] is True
    assert quiet["verdict"].startswith("Yes: sigma of yaw 0.1")
    assert 0.01 < quiet["sigma_deg"]["roll"] < 0.04 < quiet["protection_deg"]["roll"] < 0.2
    assert [row["usable"] for row in quiet["carriers"]] == [True] * 16
    first = quiet["carriers"][0]
    assert first["daily_change"]["law"] == "dish_law"
    assert first["allan_db"][0] == {"span_s": 60.0, "deviation_db": None}, "rows are five minutes apart"
    assert first["allan_db"][1]["deviation_db"] == pytest.approx(0.16, abs=0.04)
    assert len(document["further"]) == 3
    assert document["further"][0]["bound_ratio"]["roll"] < 0.95
    text = (folder / "report.md").read_text()
    for words in (
        "# Plan of yamal-202",
        "Yes: sigma of yaw",
        "noise: that of quiet.csv",
        "points of gain from",
        "## Expected after the turns",
        "| protection level, usual |",
        "## Carriers: daily change with its fit",
        "| a user near",
        "## Recommended turns, 8.5 h in all",
    ):
        assert words in text
    for name in ("stations.png", "quiet-days.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")


def test_turns_within_the_quiet_days_are_dated(world: World, options: list[str], tmp_path: Path) -> None:
    ground = world.ground
    whole, names = ground.phases, tuple(carrier.id for carrier in ground.carriers)
    window = whole["quiet"].__class__(whole["quiet"].start_us + 24 * HOUR_US, whole["turns"].stop_us)
    series = ground.series(window, names)
    write_powers(tmp_path / "quiet.csv", MeasurementSeries(names, series.epochs_us[::STEP], series.power_dbm[::STEP]))
    result = run(*options, "--json")
    said = result.output
    assert "the powers move as by turns of the satellite: " in said
    assert "leave these hours out of the file" in said
    if result.exit_code == 0:
        assert json.loads(result.stdout)["quiet"]["works"] is False


def rewritten(change: Callable[[str], str], name: str = "quiet.csv") -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_text(change((folder / name).read_text())) and None


def without_zone(text: str) -> str:
    return text.replace("Z,", ",")


def exchanged(text: str) -> str:
    return text.replace("latitude_deg,longitude_deg", "longitude_deg,latitude_deg")


OTHER_TLE = (
    "1 25544U 98067A   24001.50000000  .00016717  00000-0  10270-3 0  9005\n"
    "2 25544  51.6400 208.9163 0006317  69.9862  25.2906 15.49560830    01\n"
)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (rewritten(lambda text: text.replace("_dbm", "_mw")), "no column is a carrier of the plan"),
        (rewritten(lambda text: text.replace("_dbm", "")), "wanted as c00_dbm or c00_dbw"),
        (rewritten(without_zone), "rows of .* cannot be read; line 2: epoch"),
        (
            rewritten(lambda text: text.replace("-4", "-4,")),
            "864 of 864 rows .* 33 cells, the header has 17",
        ),
        (rewritten(lambda text: "\n".join(text.splitlines()[:200])), r"hold 16\.5 h; three days are wanted"),
        (rewritten(lambda text: text.splitlines()[0] + "\n"), "0 of 0 rows of .* there are none"),
        (rewritten(exchanged, "contours.csv"), "exchanged"),
        (rewritten(lambda text: text.replace("Ku1,", "Ku9,"), "contours.csv"), "no carrier passes through 'Ku9'"),
        (rewritten(lambda text: text.replace("gain_db", "gain"), "contours.csv"), "the columns must be transponder"),
        (rewritten(lambda _: OTHER_TLE, "orbit.json"), "tle|not geosynchronous|checksum"),
        (rewritten(lambda text: text.replace('tude_deg": [', 'tude_deg": [11.0, ', 1), "orbit.json"), "equally long"),
        (rewritten(lambda _: "no orbit", "orbit.json"), "the file is no TLE, OMM, OEM or JSON"),
    ],
)
def test_mistakes_are_refused_in_a_sentence(
    options: list[str], tmp_path: Path, change: Callable[[Path], None], words: str
) -> None:
    change(tmp_path)
    result = run(*options)
    said = " ".join(result.output.split())
    assert result.exit_code == 2, said
    assert re.search(words, said), said
    assert "Traceback" not in said


def test_the_orbit_of_another_satellite_is_refused(options: list[str], tmp_path: Path) -> None:
    orbit = json.loads((tmp_path / "orbit.json").read_text())
    orbit["track"]["longitude_deg"] = [value - 20.0 for value in orbit["track"]["longitude_deg"]]
    (tmp_path / "orbit.json").write_text(json.dumps(orbit))
    result = run(*options)
    assert result.exit_code == 2
    assert "deg East, the catalogue has 90 deg; check the satellite" in " ".join(result.output.split())


def test_the_orbit_of_another_month_is_refused(world: World, options: list[str], tmp_path: Path) -> None:
    series = powers(world)
    late = MeasurementSeries(series.carrier_ids, series.epochs_us + 60 * 24 * HOUR_US, series.power_dbm)
    write_powers(tmp_path / "quiet.csv", late)
    result = run(*options)
    assert result.exit_code == 2
    assert "the quiet days begin at" in " ".join(result.output.split())


@pytest.mark.slow
def test_gaps_repeated_rows_and_missing_carriers_are_said(options: list[str], tmp_path: Path) -> None:
    header, *rows = (tmp_path / "quiet.csv").read_text().splitlines()
    names = header.split(",")
    names[4], names[6] = "humidity", "c77_dbm"
    kept = [*rows[:300], rows[299], *rows[350:]]
    (tmp_path / "quiet.csv").write_text("\n".join([",".join(names), *kept]) + "\n")
    result = run(*options[:-2], "--json")
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    notes = "\n".join(document["notes"])
    for words in (
        "columns that are no carrier of the plan: humidity, c77_dbm",
        "carriers of the plan without powers: c03, c05",
        "1 rows repeat an epoch",
        "1 gaps beyond half an hour, the longest of 4.2 h from",
        "no ephemeris: the daily change is two harmonics",
    ):
        assert words in notes
    reasons = {row["carrier"]: row["reasons"] for row in document["quiet"]["carriers"]}
    assert reasons["c03"] == ["the quiet days hold no level of it that a daily change can be fitted to"]


def test_foreign_powers_are_read_as_their_manifest_states(tmp_path: Path) -> None:
    known = write_station(tmp_path, minutes=60)
    entry = {"file": "pegel.csv", "source": "sa-1", "time_format": "%d.%m.%Y %H:%M:%S", "tz": ZONE, "unit": "dBW"}
    quiet = {"start": "2026-10-05T00:10:00Z", "stop": "2026-10-05T00:40:00Z"}
    write_manifest(tmp_path, {"powers": [entry], "windows": {"quiet": quiet}})
    plan = CarrierPlan(1, "", read_plan(tmp_path / "carriers.csv").to_records())
    rows = read_powers(tmp_path / "pegel.csv", plan).rows.series
    assert rows.epochs_us.tolist() == [round(row.epoch.timestamp() * 1e6) for row in known[10:40]]
    np.testing.assert_allclose(rows.power_dbm, [row.levels_dbm for row in known[10:40]], atol=0.001)


def test_options_that_nothing_would_read_are_refused(options: list[str]) -> None:
    alone = run(*options[:4], "--ephemeris", options[-1])
    assert (alone.exit_code, "state --quiet with it" in alone.output) == (2, True)
    service = run("--spacecraft", "yamal-202", "--quiet", options[7])
    assert (service.exit_code, "go with --spacecraft-file" in service.output) == (2, True)
