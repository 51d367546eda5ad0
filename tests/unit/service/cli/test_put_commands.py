"""``soo put KIND FILE``: what is understood, stored, left as it is and refused."""

import csv
import json
import math
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
import typer
from foreign_orbits import attitude_message, elements, omm_kvn, quaternion, tle
from typer.testing import CliRunner, Result

from service.cli.importing import put_command
from service.cli.operation import connection
from service.client.service_client import ServiceClient

SITE = {"name": "Shchyolkovo", "latitude_deg": 55.92, "longitude_deg": 38.0, "height_m": 160.0}
CRAFT = {
    "id": "yamal-202",
    "name": "Yamal-202",
    "cospar_id": "2003-053F",
    "longitude_deg": 49.0,
    "receiving_site": SITE,
    "inertia_kg_m2": [[2600, 0, 0], [0, 1400, 0], [0, 0, 2600]],
    "torque_limit_n_m": 0.05,
}
CARRIER = {
    "id": "c00",
    "station": {"name": "Rostov-on-Don", "latitude_deg": 47.23, "longitude_deg": 39.72},
    "band": "Ku",
    "transponder": "Ku1",
    "uplink_hz": 14038369000.0,
    "downlink_hz": 11488369000.0,
    "bandwidth_hz": 1250000.0,
}
FIRST = datetime(2026, 3, 21, tzinfo=UTC)
PAST = ("--state", "tz=UTC", "--state", "last_day=2026-03-21")


class Catalogue:
    """A service with one spacecraft, or none."""

    def __init__(self) -> None:
        self.craft: dict[str, Any] | None = dict(CRAFT)
        self.sent: list[tuple[str, str, Any]] = []

    def handle(self, request: httpx.Request) -> httpx.Response:
        """Answer one request."""
        if request.method == "GET":
            if request.url.path.endswith("/status"):
                now = {"now": "2026-03-21T00:00:00.000000Z"}
                angles = {"aligned": False, "pending": 0, "newest_attitude": None}
                return httpx.Response(200, json=now | angles | {"calibration_id": None, "alignment_id": None})
            if request.url.path.endswith("/carriers"):
                return httpx.Response(200, json={"plan_id": 7, "carriers": [CARRIER]})
            if self.craft is None:
                return httpx.Response(404, json={"code": "spacecraft.unknown", "detail": "none"})
            return httpx.Response(200, json=self.craft)
        body = json.loads(request.content)
        self.sent.append((request.method, request.url.path.rpartition("/")[2], body))
        rows = len(body.get("references", ())) + len(body.get("measurements", ()))
        counts = {"accepted": rows, "duplicates": 0, "late": 0, "refused": []}
        return httpx.Response(200, json={"ephemeris_id": 1, "plan_id": 1, "carriers": 1, **counts})


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Catalogue:
    """The service that the commands are connected with."""
    made = Catalogue()

    def connected(*_: object, **__: object) -> ServiceClient:
        return ServiceClient("http://service", "key", retries=0, http=httpx.MockTransport(made.handle))

    monkeypatch.setattr(connection, "connected", connected)
    return made


def put(kind: str, path: Path, *options: str) -> Result:
    """Run one command."""
    named = () if kind == "spacecraft" else ("--spacecraft", "yamal-202")
    app = typer.Typer()
    app.command()(put_command.put)
    return CliRunner().invoke(app, [kind, str(path), *named, *options])


def write(folder: Path, content: str, name: str = "file") -> Path:
    """Return a file."""
    path = folder / name
    path.write_text(content)
    return path


def spacecraft_csv(document: dict[str, Any]) -> str:
    """Return a document as lines of field and value."""
    lines = [f"{name};{json.dumps(value)}" for name, value in document.items() if name != "receiving_site"]
    lines += [f"receiving_site.{name};{value}" for name, value in document["receiving_site"].items()]
    return "\r\n".join(("field;value", *lines)) + "\r\n"


@pytest.mark.parametrize("form", [json.dumps, spacecraft_csv])
def test_a_spacecraft_is_created_once_and_changed_only_when_asked(
    service: Catalogue, tmp_path: Path, form: Any
) -> None:
    service.craft = None
    path = write(tmp_path, form(CRAFT))
    dry = put("spacecraft", path, "--dry-run")
    assert (dry.exit_code, service.sent) == (0, []), dry.output
    done = put("spacecraft", path)
    assert done.exit_code == 0, done.output
    assert [(method, name) for method, name, _ in service.sent] == [("POST", "spacecraft")]
    assert service.sent[0][2] == CRAFT
    service.craft, service.sent = {**CRAFT, "simulated": False}, []
    assert put("spacecraft", path).exit_code == 0
    assert service.sent == []
    service.craft = {**CRAFT, "torque_limit_n_m": 0.1}
    different = put("spacecraft", path)
    assert different.exit_code == 3
    assert "torque_limit_n_m: the file has 0.05, the service 0.1" in different.output
    assert service.sent == []
    assert put("spacecraft", path, "--change").exit_code == 0
    assert service.sent == [("PATCH", "yamal-202", {"torque_limit_n_m": 0.05})]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (json.dumps({**CRAFT, "longitude_deg": 400.0}), "/longitude_deg"),
        (json.dumps({**CRAFT, "receiving_site": {**SITE, "latitude_deg": 38.0, "longitude_deg": -120.0}}), "elevation"),
        (json.dumps({**CRAFT, "colour": "red"}), "/colour"),
        ("{", "refused"),
        ("a,b\n1,2\n", "columns field and value"),
        ("field,value\nid,x\nid,y\n", "occurs twice"),
        ("field,value\nid,x\nid.y,z\n", "lies within a field"),
        ("field,value\nid,x,y\n", "3 cells"),
    ],
)
def test_a_file_that_is_no_spacecraft_is_refused(
    service: Catalogue, tmp_path: Path, content: str, message: str
) -> None:
    done = put("spacecraft", write(tmp_path, content))
    assert done.exit_code == 2
    assert message in done.output
    assert service.sent == []


@pytest.mark.parametrize(
    "content",
    [
        json.dumps({"carriers": [CARRIER]}),
        json.dumps([CARRIER]),
        "\ufeffid;station_name;station_latitude_deg;station_longitude_deg;band;transponder;uplink_hz;downlink_hz;"
        "bandwidth_hz\nc00;Rostov-on-Don;47.23;39.72;Ku;Ku1;14038369000;11488369000;1250000\n",
    ],
)
def test_a_plan_is_shown_and_stored(service: Catalogue, tmp_path: Path, content: str) -> None:
    path = write(tmp_path, content)
    dry = put("carriers", path, "--dry-run", "--json")
    assert (dry.exit_code, service.sent) == (0, []), dry.output
    assert json.loads(dry.output)["carriers"][0]["elevation_deg"] == "35.0"
    assert put("carriers", path).exit_code == 0
    assert service.sent == [("PUT", "carriers", {"carriers": [CARRIER]})]


def test_exchanged_coordinates_of_stations_are_told(service: Catalogue, tmp_path: Path) -> None:
    service.craft = {**CRAFT, "longitude_deg": 90.0}
    station = {"name": "Vladivostok", "latitude_deg": 131.9, "longitude_deg": 43.1}
    done = put("carriers", write(tmp_path, json.dumps([{**CARRIER, "station": station}])))
    assert done.exit_code == 2
    assert "latitude" in done.output
    station = {"name": "Bengaluru", "latitude_deg": 77.6, "longitude_deg": 13.0}
    done = put("carriers", write(tmp_path, json.dumps([{**CARRIER, "station": station}])))
    assert done.exit_code == 2
    assert "latitude and longitude look exchanged" in done.output
    assert service.sent == []


@pytest.mark.parametrize("form", [lambda known: "\n".join(["YAMAL 202", *tle(known)]), omm_kvn])
def test_an_orbit_is_shown_and_stored(service: Catalogue, tmp_path: Path, form: Any) -> None:
    path = write(tmp_path, form(elements(49.0)))
    steep = put("ephemeris", path)
    assert (steep.exit_code, "state inclined if that is so" in steep.output) == (2, True)
    dry = put("ephemeris", path, "--dry-run", "--json", "--state", "inclined=true")
    assert (dry.exit_code, service.sent) == (0, []), dry.output
    understood = json.loads(dry.output)["understood"]
    assert understood["object"] == "YAMAL 202"
    assert understood["mean_longitude_deg_east"] == pytest.approx(49.0, abs=1.0)
    assert understood["is_over"] is False
    assert put("ephemeris", path, "--state", "inclined=true").exit_code == 0
    ((method, name, body),) = service.sent
    assert (method, name, list(body)[-1]) == ("PUT", "ephemeris", "tle" if form is not omm_kvn else "track")


def test_the_orbit_of_another_satellite_is_refused(service: Catalogue, tmp_path: Path) -> None:
    neighbour = write(tmp_path, "\n".join(tle(elements(49.0, designator="2014-010A"))))
    done = put("ephemeris", neighbour)
    assert done.exit_code == 2
    assert "2014-010A; spacecraft yamal-202 is 2003-053F" in done.output
    far = write(tmp_path, "\n".join(tle(elements(90.0))))
    done = put("ephemeris", far)
    assert done.exit_code == 2
    assert "the orbit of another satellite: the mean longitude over a day is" in done.output
    assert service.sent == []
    assert put("ephemeris", far, "--state", "relocating=true", "--state", "inclined=true").exit_code == 0
    assert service.sent[0][2]["relocating"] is True


def attitudes(rows: int = 20) -> list[tuple[float, float, float]]:
    """Return yaw, roll and pitch, deg."""
    return [(0.3 * math.sin(k), 0.2 * math.cos(k), 0.1 * math.sin(2 * k)) for k in range(rows)]


def sensor_csv(path: Path, header: list[str], order: tuple[int, ...], first: datetime = FIRST) -> Path:
    """Return a table of angles in some order of columns."""
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["Time", *header])
        table.writerows(
            [(first + timedelta(minutes=k)).strftime("%Y-%m-%d %H:%M:%S"), *(f"{each[n]:.6f}" for n in order)]
            for k, each in enumerate(attitudes())
        )
    return path


def tracking_message(power_dbw: list[float]) -> str:
    """Return a message of another program with powers of one carrier, a minute after the other."""
    head = ("CCSDS_TDM_VERS = 2.0", "CREATION_DATE = 2026-080T01:00:00", "ORIGINATOR = X", "META_START")
    meta = ("TIME_SYSTEM = UTC", "PARTICIPANT_1 = YAMAL-202", "PARTICIPANT_2 = Moscow", "TRACK_ID = c00", "META_STOP")
    rows = (f"CARRIER_POWER = 2026-080T00:{k:02d}:00.000 {power}" for k, power in enumerate(power_dbw))
    return "\n".join((*head, *meta, "DATA_START", *rows, "DATA_STOP", ""))


def test_readings_of_a_table_and_of_a_message_reach_the_service(service: Catalogue, tmp_path: Path) -> None:
    path = sensor_csv(tmp_path / "star.csv", ["pitch_deg", "yaw_deg", "roll_deg"], (2, 0, 1))
    done = put("references", path, *PAST, "--state", "sigma_deg={yaw: 0.02, roll: 0.01}")
    assert done.exit_code == 0, done.output
    assert "not checked" in done.output
    by_table = service.sent.pop()[2]
    assert by_table["source"] == "star_tracker"
    assert by_table["references"][3]["sigma_deg"] == {"yaw": 0.02, "roll": 0.01}
    epochs = [FIRST + timedelta(minutes=k) for k in range(20)]
    rows = [(epoch, quaternion(*angles)) for epoch, angles in zip(epochs, attitudes(), strict=True)]
    message = write(tmp_path, attitude_message(rows, scalar="LAST"))
    assert put("references", message, *PAST[2:], "--source", "other").exit_code == 0
    by_message = service.sent.pop()[2]
    for one, other, angles in zip(by_table["references"], by_message["references"], attitudes(), strict=True):
        assert one["epoch"] == other["epoch"]
        for axis, angle in zip(("yaw", "roll", "pitch"), angles, strict=True):
            assert one[f"{axis}_deg"] == pytest.approx(angle, abs=1e-6)
            assert other[f"{axis}_deg"] == pytest.approx(angle, abs=1e-6)
    document = write(tmp_path, json.dumps(by_table), "references.json")
    assert put("references", document, *PAST[2:]).exit_code == 0
    assert service.sent.pop()[2] == {
        **by_table,
        "references": [
            {**each, "sigma_deg": {"yaw": 0.02, "roll": 0.01, "pitch": None}} for each in by_table["references"]
        ],
    }
    assert put("references", document, "--source", "earth_sensor").exit_code == 2


def test_powers_of_a_tracking_message_reach_the_service(service: Catalogue, tmp_path: Path) -> None:
    stated = (*PAST[2:], "--source", "ground-2", "--progress", str(tmp_path))
    message = tracking_message([-52.1, -52.3, -51.9])
    done = put("powers", write(tmp_path, message, "powers.tdm"), *stated)
    assert done.exit_code == 0, done.output
    (sent,) = (body for _, path, body in service.sent if path == "measurements:batch")
    assert (sent["plan_id"], sent["source"]) == (7, "ground-2")
    assert [each["power_dbm"] for each in sent["measurements"]] == [[-22.1], [-22.3], [-21.9]]
    assert sent["measurements"][1]["epoch"] == "2026-03-21T00:01:00.000000Z"
    uncorrected = message.replace("META_STOP", "CORRECTIONS_APPLIED = NO\nCORRECTION_RANGE = 1\nMETA_STOP")
    refused = put("powers", write(tmp_path, uncorrected, "raw.tdm"), *stated)
    assert (refused.exit_code, "CORRECTION_RANGE" in refused.output) == (2, True), refused.output


def test_what_must_be_stated_of_a_sensor_is_printed(service: Catalogue, tmp_path: Path) -> None:
    path = sensor_csv(tmp_path / "star.csv", ["yaw", "roll", "pitch"], (0, 1, 2))
    done = put("references", path)
    assert done.exit_code == 2
    assert done.output.splitlines()[-1].endswith("--state tz=UTC --state unit=deg --state last_day=2026-03-21")
    assert put("references", path, *PAST, "--state", "unit=deg", "--dry-run").exit_code == 0
    assert service.sent == []


def test_readings_that_cannot_be_are_refused(service: Catalogue, tmp_path: Path) -> None:
    header, order = ["yaw_deg", "roll_deg", "pitch_deg"], (0, 1, 2)
    ahead = sensor_csv(tmp_path / "ahead.csv", header, order, datetime.now(UTC) + timedelta(hours=3))
    done = put("references", ahead, "--state", "tz=UTC")
    assert done.exit_code == 2
    assert "ahead of now" in done.output
    # degrees that somebody calls radians
    mistaken = sensor_csv(tmp_path / "mistaken.csv", ["yaw", "roll", "pitch"], order)
    lines = mistaken.read_text().splitlines()
    mistaken.write_text("\n".join((lines[0], *(f"{line.rpartition(',')[0]},0.4" for line in lines[1:]))) + "\n")
    done = put("references", mistaken, *PAST, "--state", "unit=rad")
    assert done.exit_code == 2
    assert "beyond the Earth's disc" in done.output
    assert put("references", mistaken, *PAST, "--state", "unit=deg", "--state", "sigma_deg={tilt: 1}").exit_code == 2
    assert service.sent == []


def test_lines_that_cannot_be_read_are_grouped_and_the_others_sent(service: Catalogue, tmp_path: Path) -> None:
    path = sensor_csv(tmp_path / "star.csv", ["yaw_deg", "roll_deg", "pitch_deg"], (0, 1, 2))
    lines = path.read_text().splitlines()
    lines[3] = lines[3].rpartition(",")[0] + ",lost"
    path.write_text("\n".join(lines) + "\n")
    done = put("references", path, *PAST, "--json")
    assert done.exit_code == 3
    report = json.loads(done.output)
    assert (report["accepted"], report["unreadable"]) == (19, 1)
    assert "holds no number with decimal point, like " in report["faults"][0]


@pytest.mark.parametrize(
    ("kind", "content", "message"),
    [
        ("spacecraft", json.dumps({**CRAFT, "inertia_kg_m2": [[2.6, 0, 0], [0, 1.4, 0], [0, 0, 2.6]]}), "1.4 kg m^2"),
        ("spacecraft", json.dumps({**CRAFT, "torque_limit_n_m": 50.0}), "50 N m"),
        (
            "carriers",
            json.dumps([{**CARRIER, "station": {"name": "Brest", "latitude_deg": 47.0, "longitude_deg": -23.0}}]),
            "the sign of the longitudes turned",
        ),
        ("carriers", json.dumps([{**CARRIER, "uplink_hz": 11.4e9, "downlink_hz": 14.0e9}]), "look exchanged"),
        (
            "carriers",
            json.dumps([{**CARRIER, "id": f"c{k}"} for k in range(8)]),
            "all 8 carriers are on transponder Ku1",
        ),
    ],
)
def test_a_catalogue_that_no_satellite_has_must_be_confirmed(
    service: Catalogue, tmp_path: Path, kind: str, content: str, message: str
) -> None:
    service.craft = None if kind == "spacecraft" else service.craft
    path = write(tmp_path, content)
    done = put(kind, path)
    assert (done.exit_code, message in done.output, service.sent) == (2, True, []), done.output
    assert put(kind, path, "--state", "confirmed=true").exit_code == 0
    assert len(service.sent) == 1
