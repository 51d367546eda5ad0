"""``soo plan``: from files or a service, reports of quiet days, and what is refused."""

import json
import math
import re
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from foreign_station import ZONE, write_station
from plan_files import write_plan_files, write_powers
from typer.testing import CliRunner

from service.cli.importing.catalogue import read_plan
from service.cli.importing.manifest import write_manifest
from service.cli.operation import connection
from service.cli.planning.plan import plan
from service.cli.planning.sources import read_powers
from service.core.geometry.frames import station_direction
from service.formats.carrier_plan_csv import COLUMNS
from service.records.catalogue import CarrierPlan
from service.records.levels.measurement import MeasurementSeries
from service.study.estimation.flight.world import World, simulated_world

SPACECRAFT: dict[str, Any] = {
    "id": "yamal-202",
    "name": "Yamal-202",
    "longitude_deg": 90.0,
    "receiving_site": {"name": "Dubna", "latitude_deg": 56.74, "longitude_deg": 37.19},
    "inertia_kg_m2": [[2600, 0, 0], [0, 1400, 0], [0, 0, 2600]],
    "torque_limit_n_m": 0.05,
}
#: latitude, longitude; the last lies beyond the horizon
STATIONS = [(45 + 3 * (k % 8), 30 + 7 * k, f"Ku{k % 4}") for k in range(19)] + [(52.0, -60.0, "Ku0")]


def carriers_csv() -> str:
    lines = [",".join(COLUMNS)]
    for k, (latitude, longitude, transponder) in enumerate(STATIONS):
        cells = {
            "id": f"c{k:02d}",
            "station_latitude_deg": latitude,
            "station_longitude_deg": longitude,
            "band": "Ku",
            "transponder": transponder,
            "uplink_hz": 14.25e9,
            "downlink_hz": 11.2e9,
            "bandwidth_hz": 1e6,
            "uplink_power_control": "auto" if k == 3 else "none",
        }
        lines.append(",".join(str(cells.get(name, "")) for name in COLUMNS))
    return "\n".join(lines)


@pytest.fixture
def files(tmp_path: Path) -> list[str]:
    (tmp_path / "spacecraft.json").write_text(json.dumps(SPACECRAFT))
    (tmp_path / "carriers.csv").write_text(carriers_csv())
    return ["--spacecraft-file", str(tmp_path / "spacecraft.json"), "--carriers-file", str(tmp_path / "carriers.csv")]


def plan_run(*options: str, key: str = "secret") -> Any:
    app = typer.Typer()
    app.command()(plan)
    return CliRunner().invoke(app, list(options), env={"SOO_KEY": key})


def reported(*options: str) -> dict[str, Any]:
    result = plan_run(*options, "--json")
    assert result.exit_code == 0, result.output
    document: dict[str, Any] = json.loads(result.stdout)
    return document


def test_files_and_nothing_else_give_a_choice(files: list[str]) -> None:
    document = reported(*files, "--count", "12")
    assert (document["rule"], document["calibration_id"], len(document["selected"])) == ("optimal", None, 12)
    assert document["sufficient"] is True
    reasons = {row["carrier"]: row["reasons"] for row in document["carriers"]}
    assert reasons["c03"] == ["not usable for attitude: disabled, a beacon, or under uplink power control"]
    assert reasons["c19"] == ["the satellite is below the horizon of its station"]
    assert len(document["sets"]["all"]["selected"]) == 18
    notes = "\n".join(document["notes"])
    for words in (
        "beam of Ku0: centre az",
        "assumed on the middle of its stations",
        "links that flicker",
        "stable and",
    ):
        assert words in notes
    sigma = [row["sigma_deg"]["roll"] for row in document["sets"]["optimal"]["averaged"]]
    one_row = document["sets"]["optimal"]["crlb_deg"]["roll"]
    assert one_row > sigma[0] > sigma[1] > sigma[2] > sigma[3] > 0.3 * one_row, "links that flicker hardly average"


def test_quiet_noise_averages_well(files: list[str]) -> None:
    figures = reported(*files, "--noise", "quiet")["sets"]["all"]
    # 0.155 dB white and 0.09 dB of 20 min: in 12 h 720 rows and 36 correlation times
    kept_db = math.sqrt(0.155**2 / 720 + 0.09**2 * 2 * (36 - 1 + math.exp(-36)) / 36**2)
    expected = kept_db / math.hypot(0.155, 0.09) * figures["crlb_deg"]["roll"]
    assert figures["averaged"][3]["sigma_deg"]["roll"] == pytest.approx(expected, rel=1e-9)  # rounding


def test_report_for_people(files: list[str], tmp_path: Path) -> None:
    figure = tmp_path / "map.png"
    result = plan_run(*files, "--turns-start", "2026-11-21T06:00:00Z", "--far-yaw", "--figure", str(figure))
    assert result.exit_code == 0, result.output
    for words in (
        "rule optimal",
        "Sets of carriers",
        "CRLB yaw / roll / pitch, deg",
        "largest undetectable fault, dB",
        "Sigma of yaw / roll / pitch from powers alone, deg",
        "12 h",
        "Left out",
        "Recommended turns, 8.5 h in all",
        "2026-11-21T06:15:00.000000Z",
        "+1.000",
    ):
        assert words in result.output
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert "Recommended turns" in (relative := plan_run(*files).output)
    assert "+8:20" in relative, "without a start the timetable counts from it"


def test_stated_beams_replace_assumed_ones(files: list[str]) -> None:
    document = reported(*files, "--beam", "Ku0=-2,7,5", "--beam", "1,8,4,3")
    notes = "\n".join(document["notes"])
    assert "beam of Ku0: centre az -2.00, el +7.00 deg, half-power width 5.0 x 5.0 deg, as stated" in notes
    assert "beam of Ku1: centre az +1.00, el +8.00 deg, half-power width 4.0 x 3.0 deg, as stated" in notes
    first = document["carriers"][0]["sensitivity_db_per_deg"]
    position = station_direction([30.0], [45.0], [0.0], 90.0)
    azimuth_deg, elevation_deg = float(position.azimuth_deg[0]), float(position.elevation_deg[0])
    # slope 24 / 25 dB/deg^2; through the tangents of 6 deg each axis takes one per cent of the other slope
    assert first["pitch"] == pytest.approx(24 / 25 * (azimuth_deg + 2.0), abs=0.05)
    assert first["roll"] == pytest.approx(24 / 25 * (elevation_deg - 7.0), abs=0.05)


def test_one_round_beam_shows_no_yaw_and_says_so(files: list[str]) -> None:
    document = reported(*files, "--beam", "0,7.5,6")
    assert any("shows no yaw" in note for note in document["notes"])
    for name in ("crlb_deg", "crlb_without_common_deg"):
        yaw = document["sets"]["all"][name]["yaw"]
        # the tangents of the exact rotation leave a little of it
        assert yaw is None or yaw > 10.0
    oval = reported(*files, "--beam", "0,7.5,6,3")
    assert any("by its ellipticity only" in note for note in oval["notes"])
    assert oval["sets"]["all"]["crlb_deg"]["yaw"] < 10.0


def test_plan_of_json_is_read_too(files: list[str], tmp_path: Path) -> None:
    carriers = [
        {
            "id": f"c{k:02d}",
            "station": {"latitude_deg": latitude, "longitude_deg": longitude},
            "band": "Ku",
            "transponder": transponder,
            "uplink_hz": 14.25e9,
            "downlink_hz": 11.2e9,
            "bandwidth_hz": 1e6,
        }
        for k, (latitude, longitude, transponder) in enumerate(STATIONS[:8])
    ]
    path = tmp_path / "carriers.json"
    path.write_text(json.dumps({"carriers": carriers}))
    document = reported(*files[:3], str(path))
    assert document["count"] == 8, "sixteen are wanted by default, or all when there are fewer"
    assert document["shortcomings"][0] == "8 carriers; the robust method wants at least 12"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--beam", "1,2"], "is no beam; write [TRANSPONDER=]AZ,EL,WIDTH"),
        (["--beam", "1,2,-3"], "is no beam"),
        (["--beam", "=1,2,3"], "is no beam"),
        (["--beam", "nan,2,3"], "is no beam"),
        (["--beam", "Ku9=1,2,3"], "no carrier passes through 'Ku9'; the transponders are Ku0, Ku1, Ku2, Ku3"),
        (["--count", "21"], "the carrier plan has 20 carriers"),
        (["--turns-start", "tomorrow"], "tomorrow"),
        (["--figure", "nowhere/map.png"], "the figure cannot be written"),
        (["--figure", "map.xyz"], "the figure cannot be written"),
        (["--spacecraft", "yamal-202"], "name a spacecraft of the service, or both"),
    ],
)
def test_what_cannot_be_planned_is_said_in_a_sentence(files: list[str], options: list[str], words: str) -> None:
    result = plan_run(*files, *options)
    assert result.exit_code == 2
    assert words in result.output
    assert "Traceback" not in result.output


def test_files_that_cannot_be_read(files: list[str], tmp_path: Path) -> None:
    (tmp_path / "broken.json").write_text('{"id": "x"}')
    (tmp_path / "broken.csv").write_text("id,colour\nc00,red\n")
    (tmp_path / "few.csv").write_text("\n".join(carriers_csv().splitlines()[:4]))
    for replaced, path, words in (
        (1, tmp_path / "broken.json", "/name: this field is required"),
        (1, tmp_path / "absent.json", "cannot be read"),
        (3, tmp_path / "broken.csv", "column 'colour' is not known"),
        (3, tmp_path / "few.csv", "only 3 carriers of the carrier plan can be used, 4 are needed"),
    ):
        options = list(files)
        options[replaced] = str(path)
        result = plan_run(*options)
        assert result.exit_code == 2
        assert words in result.output


@pytest.mark.parametrize("options", [[], ["--spacecraft-file", "x.json"], ["--carriers-file", "x.csv"]])
def test_a_source_is_needed(options: list[str]) -> None:
    result = plan_run(*options)
    assert result.exit_code == 2
    assert "--spacecraft-file and --carriers-file" in result.output


class FakeClient:
    """A service that has chosen by its calibration what the files would give."""

    def __init__(self, document: dict[str, Any]) -> None:
        self.document = document
        self.asked: list[tuple[str, dict[str, Any]]] = []

    def spacecraft(self, _spacecraft_id: str) -> dict[str, Any]:
        return SPACECRAFT

    def carriers(self, _spacecraft_id: str) -> dict[str, Any]:
        stations = [
            {"id": f"c{k:02d}", "station": {"latitude_deg": latitude, "longitude_deg": longitude}}
            for k, (latitude, longitude, _) in enumerate(STATIONS[:-1])
        ]
        # the newest plan no longer has the last carrier of the calibration, and a beacon instead
        return {"carriers": [*stations, {"id": "b0", "station": None}]}

    def request(self, _method: str, path: str, *, params: dict[str, Any]) -> dict[str, Any]:
        self.asked.append((path, params))
        return self.document


def test_a_service_is_asked_for_its_calibration(
    files: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    document = reported(*files, "--far-yaw") | {"calibration_id": 7, "calibration_method": "geometry", "notes": []}
    client = FakeClient(document)
    monkeypatch.setattr(connection, "connected", lambda *_: nullcontext(client))
    figure = tmp_path / "map.svg"
    result = plan_run("--spacecraft", "yamal-202", "--far-yaw", "--figure", str(figure))
    assert result.exit_code == 0, result.output
    assert "yamal-202: 20 carriers by calibration 7 (geometry), rule optimal" in result.output
    assert client.asked == [("/spacecraft/yamal-202/carrier-selection", {"rule": "optimal", "turns": "far_yaw"})]
    assert "<svg" in figure.read_text()
    assert json.loads(plan_run("--spacecraft", "yamal-202", "--count", "6", "--json").stdout) == document
    assert client.asked[-1][1] == {"count": 6, "rule": "optimal", "turns": "standard"}


def test_without_a_key_no_service_is_asked() -> None:
    result = plan_run("--spacecraft", "yamal-202", key="")
    assert result.exit_code == 2
    assert "the environment variable SOO_KEY is empty" in result.output


def test_wheels_of_an_option_say_what_yaw_they_would_give(files: list[str]) -> None:
    plain, wheels = (json.loads(plan_run(*files, "--json", *more).stdout) for more in ((), ("--wheels", "8")))
    assert plain["momentum"] is None
    gain = wheels["momentum"]
    assert (gain["pitch_bias_n_m_s"], gain["sigma_n_m_s"], gain["period_s"]) == (8.0, 0.01, 300.0)
    assert gain["with_deg"]["yaw"] < gain["without_deg"]["yaw"]
    assert "powers and momentum" in plan_run(*files, "--wheels", "8", "--wheel-period", "3600").stdout


HOUR_US = 3_600_000_000
#: every fifth row: what is tested here does not need the others
STEP = 5


@pytest.fixture(scope="module")
def world() -> World:
    return simulated_world("nominal", 1, 0.05)


def powers(world: World, window: str = "quiet") -> MeasurementSeries:
    ground = world.ground
    series = ground.series(ground.phases[window], tuple(carrier.id for carrier in ground.carriers))
    return MeasurementSeries(series.carrier_ids, series.epochs_us[::STEP], series.power_dbm[::STEP])


@pytest.fixture
def options(world: World, tmp_path: Path) -> list[str]:
    found = write_plan_files(world, tmp_path)
    write_powers(tmp_path / "quiet.csv", powers(world))
    return found


@pytest.mark.slow
def test_the_report_of_quiet_days(options: list[str], tmp_path: Path) -> None:
    folder = tmp_path / "report"
    result = plan_run(*options, "--report", str(folder), "--json")
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


@pytest.mark.slow
def test_turns_within_the_quiet_days_are_dated(world: World, options: list[str], tmp_path: Path) -> None:
    ground = world.ground
    whole, names = ground.phases, tuple(carrier.id for carrier in ground.carriers)
    window = whole["quiet"].__class__(whole["quiet"].start_us + 24 * HOUR_US, whole["turns"].stop_us)
    series = ground.series(window, names)
    write_powers(tmp_path / "quiet.csv", MeasurementSeries(names, series.epochs_us[::STEP], series.power_dbm[::STEP]))
    result = plan_run(*options, "--json")
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
        (rewritten(lambda text: text.replace("_dbm", "_mw")), "the name says mW, the values are negative"),
        (rewritten(lambda text: text.replace("_dbm", "")), "no column name states the unit"),
        (rewritten(without_zone), "has no offset"),
        (
            rewritten(lambda text: text.replace("-4", "-4,")),
            "33 cells, the line above has 17; a decimal comma",
        ),
        (rewritten(lambda text: "\n".join(text.splitlines()[:200])), r"hold 16\.4 h; three days are wanted"),
        (rewritten(lambda text: text.splitlines()[0] + "\n"), "no header with lines below it"),
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
    result = plan_run(*options)
    said = " ".join(result.output.split())
    assert result.exit_code == 2, said
    assert re.search(words, said), said
    assert "Traceback" not in said


def test_the_orbit_of_another_satellite_is_refused(options: list[str], tmp_path: Path) -> None:
    orbit = json.loads((tmp_path / "orbit.json").read_text())
    orbit["track"]["longitude_deg"] = [value - 20.0 for value in orbit["track"]["longitude_deg"]]
    (tmp_path / "orbit.json").write_text(json.dumps(orbit))
    result = plan_run(*options)
    assert result.exit_code == 2
    assert "deg East, the catalogue has 90 deg; check the satellite" in " ".join(result.output.split())


def test_the_orbit_of_another_month_is_refused(world: World, options: list[str], tmp_path: Path) -> None:
    series = powers(world)
    late = MeasurementSeries(series.carrier_ids, series.epochs_us + 60 * 24 * HOUR_US, series.power_dbm)
    write_powers(tmp_path / "quiet.csv", late)
    result = plan_run(*options)
    assert result.exit_code == 2
    assert "the quiet days begin at" in " ".join(result.output.split())


@pytest.mark.slow
def test_gaps_repeated_rows_and_missing_carriers_are_said(options: list[str], tmp_path: Path) -> None:
    header, *rows = (tmp_path / "quiet.csv").read_text().splitlines()
    names = header.split(",")
    names[4], names[6] = "humidity", "c77_dbm"
    kept = [*rows[:300], rows[299], *rows[350:]]
    (tmp_path / "quiet.csv").write_text("\n".join([",".join(names), *kept]) + "\n")
    result = plan_run(*options[:-2], "--json")
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    notes = "\n".join(document["notes"])
    for words in (
        "no carrier of the plan: humidity, c77_dbm",
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
    alone = plan_run(*options[:4], "--ephemeris", options[-1])
    assert (alone.exit_code, "state --quiet with it" in alone.output) == (2, True)
    service = plan_run("--spacecraft", "yamal-202", "--quiet", options[7])
    assert (service.exit_code, "go with --spacecraft-file" in service.output) == (2, True)
