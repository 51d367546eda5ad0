"""Carrier plans and ephemerides: the same content is the same version, in every form."""

import json

import pytest

pytestmark = pytest.mark.anyio


SC = "/api/v1/spacecraft"
URL = f"{SC}/yamal-202/carriers"


async def test_the_same_content_keeps_its_number_and_a_change_makes_a_new_one(soo, spacecraft, carriers):
    await soo.client.post(SC, json=spacecraft)
    first = (await soo.client.put(URL, json={"carriers": carriers})).json()
    assert set(first) == {"plan_id", "sha256", "carriers", "warnings"}
    assert (first["carriers"], len(first["sha256"])) == (4, 64)
    # written otherwise, with defaults spelled out and whole numbers for fractions: still the same
    spelled = [c | {"enabled": True, "bandwidth_hz": int(c["bandwidth_hz"])} for c in carriers]
    assert (await soo.client.put(URL, content=json.dumps({"carriers": spelled}, indent=3))).json() == first
    changed = [carriers[1], carriers[0], *carriers[2:]]
    second = (await soo.client.put(URL, json={"carriers": changed})).json()
    assert second["plan_id"] != first["plan_id"], "the order of the carriers is part of a plan"
    newest = (await soo.client.get(URL)).json()
    assert [c["id"] for c in newest["carriers"]] == ["c01", "c00", "c02", "b0"]
    older = (await soo.client.get(URL, params={"plan_id": first["plan_id"]})).json()
    assert older["sha256"] == first["sha256"]
    assert older["carriers"][0] == carriers[0] | {
        "kind": "traffic",
        "uplink_power_control": "unknown",
        "transponder_mode": "unknown",
        "enabled": True,
    }
    assert older["carriers"][3]["station"] is None


async def test_a_plan_survives_the_way_through_csv(soo, spacecraft, carriers):
    await soo.client.post(SC, json=spacecraft)
    carriers[0]["name"] = 'Quotes "and", commas\u00e9'
    put = (await soo.client.put(URL, json={"carriers": carriers})).json()
    exported = await soo.client.get(URL, headers={"Accept": "text/csv"})
    assert exported.headers["content-type"].startswith("text/csv")
    assert "yamal-202-plan-1.csv" in exported.headers["content-disposition"]
    assert (await soo.client.get(URL, params={"format": "csv"})).content == exported.content
    again = await soo.client.put(URL, content=exported.content, headers={"Content-Type": "text/csv; charset=utf-8"})
    assert again.json() == put
    # what a spreadsheet in Europe makes of it
    semicolons = (
        b"\xef\xbb\xbfid;band;transponder;downlink_hz;bandwidth_hz;kind\r\nb0;Ku;Ku1;11199e6;1e3;beacon\r\n\r\n"
    )
    answer = await soo.client.put(URL, content=semicolons, headers={"Content-Type": "text/csv"})
    assert (answer.status_code, answer.json()["carriers"]) == (200, 1)


def drop(carrier: dict, *names: str) -> dict:
    return {name: value for name, value in carrier.items() if name not in names}


@pytest.mark.parametrize(
    ("change", "code", "pointer"),
    [
        (lambda c: [], "value.length", "/carriers"),
        (lambda c: c * 200, "value.length", "/carriers"),
        (lambda c: [*c, c[0]], "carrier.duplicate", ""),
        (lambda c: [drop(c[0], "station")], "carrier.station_missing", "/carriers/0"),
        (lambda c: [c[0] | {"uplink_hz": None}], "carrier.uplink_missing", "/carriers/0"),
        (lambda c: [drop(c[0], "band")], "field.missing", "/carriers/0/band"),
        (lambda c: [drop(c[0], "bandwidth_hz")], "field.missing", "/carriers/0/bandwidth_hz"),
        (lambda c: [c[0], c[1] | {"bandwidth_hz": 0}], "value.range", "/carriers/1/bandwidth_hz"),
        (lambda c: [c[0] | {"downlink_hz": -1}], "value.range", "/carriers/0/downlink_hz"),
        (lambda c: [c[0] | {"id": "c 0"}], "value.pattern", "/carriers/0/id"),
        (lambda c: [c[0] | {"id": 0}], "value.type", "/carriers/0/id"),
        (lambda c: [c[0] | {"kind": "noise"}], "value.choice", "/carriers/0/kind"),
        (lambda c: [c[0] | {"colour": 1}], "field.unknown", "/carriers/0/colour"),
        (
            lambda c: [c[0] | {"station": {"latitude_deg": 91, "longitude_deg": 0}}],
            "value.range",
            "/carriers/0/station/latitude_deg",
        ),
        (lambda c: [c[0] | {"enabled": "yes"}], "value.type", "/carriers/0/enabled"),
        (lambda c: {}, "value.type", "/carriers"),
        (lambda c: [[]], "value.type", "/carriers/0"),
    ],
)
async def test_bad_plans_are_refused_by_code_and_place(soo, spacecraft, carriers, change, code, pointer):
    await soo.client.post(SC, json=spacecraft)
    soo.accepted.clear()
    answer = await soo.client.put(URL, json={"carriers": change(carriers)})
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (422, code), problem
    assert problem["errors"][0]["pointer"] == pointer
    missing = await soo.client.get(URL)
    assert (missing.status_code, missing.json()["code"]) == (404, "plan.none")
    assert soo.accepted == []


HEADER = "id,band,transponder,downlink_hz,bandwidth_hz,kind,enabled\n"


@pytest.mark.parametrize(
    ("raw", "code", "pointer"),
    [
        (b"", "csv.malformed", ""),
        (b"\xff\xfe", "csv.malformed", ""),
        (b'id,"band\n', "csv.malformed", ""),
        (b"id,colour\n", "csv.malformed", ""),
        (b"id,id\n", "csv.malformed", ""),
        (b"id,band\n", "csv.malformed", ""),
        (HEADER.encode(), "value.length", "/carriers"),
        ((HEADER + "b0,Ku\n").encode(), "csv.malformed", "/carriers/0"),
        ((HEADER + "b0,Ku,Ku1,high,1,beacon,\n").encode(), "csv.malformed", "/carriers/0/downlink_hz"),
        ((HEADER + "b0,Ku,Ku1,nan,1,beacon,\n").encode(), "value.not_finite", "/carriers/0/downlink_hz"),
        ((HEADER + "b0,Ku,Ku1,inf,1,beacon,\n").encode(), "value.not_finite", "/carriers/0/downlink_hz"),
        ((HEADER + "b0,Ku,Ku1,1,1,beacon,maybe\n").encode(), "csv.malformed", "/carriers/0/enabled"),
        ((HEADER + "b0,Ku,Ku1,1,1,traffic,true\n").encode(), "carrier.station_missing", "/carriers/0"),
        ((HEADER + "b0,,Ku1,1,1,beacon,true\n").encode(), "field.missing", "/carriers/0/band"),
        ((HEADER + "b0,K\x00u,Ku1,1,1,beacon,true\n").encode(), "value.pattern", "/carriers/0/band"),
    ],
)
async def test_bad_csv_is_refused_by_code_and_place(soo, spacecraft, raw, code, pointer):
    await soo.client.post(SC, json=spacecraft)
    answer = await soo.client.put(URL, content=raw, headers={"Content-Type": "text/csv"})
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (422, code), problem
    assert problem["errors"][0]["pointer"] == pointer
    assert (await soo.client.get(URL)).status_code == 404


async def test_other_media_and_other_plans_are_refused(soo, spacecraft, carriers):
    await soo.with_plan(spacecraft, carriers)
    xml = await soo.client.put(URL, content=b"<plan/>", headers={"Content-Type": "application/xml"})
    assert (xml.status_code, xml.json()["code"]) == (415, "media_type.unsupported")
    unknown = await soo.client.get(URL, params={"plan_id": 9})
    assert (unknown.status_code, unknown.json()["code"]) == (404, "plan.unknown")
    for text in ("0", "x", "99999999999999999999", "1.5"):
        bad = await soo.client.get(URL, params={"plan_id": text})
        assert (bad.status_code, bad.json()["errors"][0]["pointer"]) == (422, "/query/plan_id")
    nobody = await soo.client.put(f"{SC}/nobody/carriers", json={"carriers": carriers})
    assert (nobody.status_code, nobody.json()["code"]) == (404, "spacecraft.unknown")


async def put(soo, spacecraft, carriers):
    await soo.client.post("/api/v1/spacecraft", json=spacecraft)
    return await soo.client.put("/api/v1/spacecraft/yamal-202/carriers", json={"carriers": carriers})


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"downlink_hz": 11.2e3, "band": "any"}, "carrier.frequency"),
        ({"downlink_hz": 61e9, "band": "any"}, "carrier.frequency"),
        ({"downlink_hz": 3.6e9, "band": "Ku"}, "carrier.band"),
        ({"uplink_hz": 14.0e6, "band": "ku"}, "carrier.band"),
        ({"uplink_hz": 14.25e9, "downlink_hz": 11.2e9, "band": "C"}, "request.invalid"),
    ],
)
async def test_frequencies_outside_their_band_are_refused_with_both_values(soo, spacecraft, carriers, change, code):
    answer = await put(soo, spacecraft, [carriers[0] | change, *carriers[1:]])
    assert (answer.status_code, answer.json()["code"]) == (422, code)
    assert answer.json()["errors"][0]["pointer"].startswith("/carriers/0/")
    assert " GHz, " in answer.json()["errors"][0]["detail"]
    assert (await soo.client.get("/api/v1/spacecraft/yamal-202/carriers")).status_code == 404


@pytest.mark.parametrize(
    ("band", "uplink_hz", "downlink_hz"),
    [
        ("L", 1.6265e9, 1.525e9),
        ("S", 1.98e9, 2.17e9),
        ("C", 5.85e9, 3.4e9),
        ("C", 7.025e9, 4.8e9),
        ("X", 8.4e9, 7.25e9),
        ("Ku", 14.8e9, 12.75e9),
        ("Ku", 18.1e9, 10.7e9),
        ("Ka", 31.0e9, 17.3e9),
        ("V", 50.2e9, 40.5e9),
    ],
)
async def test_frequencies_of_the_radio_regulations_are_accepted(
    soo, spacecraft, carriers, band, uplink_hz, downlink_hz
):
    change = {"band": band, "uplink_hz": uplink_hz, "downlink_hz": downlink_hz}
    assert (await put(soo, spacecraft, [carriers[0] | change])).status_code == 200


async def test_stations_below_the_horizon_are_refused_and_low_ones_warned_of(soo, spacecraft, carriers):
    low = carriers[0] | {"station": {"latitude_deg": 65.0, "longitude_deg": 24.0}}
    answer = await put(soo, spacecraft, [low, *carriers[1:]])
    assert [(each["pointer"], each["code"]) for each in answer.json()["warnings"]] == [
        ("/carriers/0/station", "station.low")
    ]
    below = carriers[0] | {"station": {"latitude_deg": 40.0, "longitude_deg": -100.0}}
    answer = await put(soo, spacecraft, [carriers[1], below])
    assert (answer.status_code, answer.json()["code"]) == (422, "station.below_horizon")
    assert answer.json()["errors"][0]["pointer"] == "/carriers/1/station"
    assert "exchanged" not in answer.json()["detail"]


async def test_exchanged_latitude_and_longitude_are_suspected(soo, spacecraft, carriers):
    """Stations of Siberia and the Far East, latitude 50 to 60, longitude 85 to 89, exchanged."""
    stations = [{"latitude_deg": 85.0 + k, "longitude_deg": 50.0 + 3 * k} for k in range(3)]
    exchanged = [carriers[0] | {"id": f"x{k}", "station": station} for k, station in enumerate(stations)]
    answer = await put(soo, spacecraft, exchanged)
    assert answer.status_code == 422
    assert all("look exchanged" in error["detail"] for error in answer.json()["errors"])


EPHEMERIS_URL = f"{SC}/yamal-202/ephemeris"
NODES = ["2026-11-20T03:00:00.000000Z", "2026-11-21T02:58:48.000000Z"]
TRACK = {
    "epochs": ["2026-11-20T00:00:00.000000Z", "2026-11-20T12:00:00.000000Z", "2026-11-23T00:00:00.000000Z"],
    "latitude_deg": [0.0, 1.5, -1.5],
    "longitude_deg": [90.0, 90.05, 89.95],
}
TLE = [
    "1 28089U 03053F   26324.50000000 -.00000100  00000-0  00000+0 0  9991",
    "2 28089   5.9000  60.0000 0003000 100.0000 260.0000  1.00270000 75003",
]


def checked(line: str) -> str:
    digits = sum(int(c) if c.isdigit() else c == "-" for c in line[:68])
    return line[:68] + str(digits % 10)


async def test_nodes_give_their_validity_and_versions_are_kept(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    soo.accepted.clear()
    first = await soo.client.put(EPHEMERIS_URL, json={"ascending_nodes": NODES, "nodal_period_s": 86328.0})
    assert first.status_code == 200, first.text
    assert first.json() == {
        "ephemeris_id": 1,
        "ascending_nodes": NODES,
        "nodal_period_s": 86328.0,
        "valid": {"start": "2026-11-19T03:01:12.000000Z", "stop": "2026-11-22T02:57:36.000000Z"},
        "form": "nodes",
    }
    second = (await soo.client.put(EPHEMERIS_URL, json={"ascending_nodes": NODES, "track": TRACK})).json()
    assert second["ephemeris_id"] == 2
    assert second["nodal_period_s"] == 86328.0, "found from the nodes"
    assert second["valid"] == {"start": TRACK["epochs"][0], "stop": TRACK["epochs"][-1]}
    assert (await soo.client.get(EPHEMERIS_URL)).json() == second | {"track": TRACK}
    assert (await soo.client.get(EPHEMERIS_URL, params={"ephemeris_id": 1})).json() == first.json() | {"track": None}
    assert soo.accepted == ["yamal-202", "yamal-202"]


async def test_two_line_elements_give_nodes_period_and_track(soo, spacecraft):
    site = {"latitude_deg": 50.0, "longitude_deg": 160.0}
    await soo.client.post(SC, json=spacecraft | {"longitude_deg": 180.0, "receiving_site": site})
    answer = await soo.client.put(EPHEMERIS_URL, json={"tle": [checked(line) for line in TLE]})
    assert answer.status_code == 200, answer.text
    stored = (await soo.client.get(EPHEMERIS_URL)).json()
    assert stored["form"] == "tle"
    assert len(stored["ascending_nodes"]) >= 36
    # a sidereal day has 86164 s; the node of an orbit of 5.9 deg drifts by seconds a day
    assert stored["nodal_period_s"] == pytest.approx(86164, abs=20)
    latitude_deg = stored["track"]["latitude_deg"]
    # the inclination moves by some hundredths in a month, and eccentricity adds nothing to latitude
    assert max(latitude_deg) == pytest.approx(5.9, abs=0.1)


LINE_1, LINE_2 = (checked(line) for line in TLE)
BAD = [
    ("nothing", {}, "ephemeris.form", ""),
    ("two forms", {"ascending_nodes": NODES, "tle": [LINE_1, LINE_2]}, "ephemeris.form", ""),
    ("track with elements", {"tle": [LINE_1, LINE_2], "nodal_period_s": 86164}, "ephemeris.form", ""),
    ("no nodes", {"ascending_nodes": []}, "value.length", "/ascending_nodes"),
    ("one node, no period", {"ascending_nodes": NODES[:1]}, "ephemeris.period_missing", "/ascending_nodes"),
    ("descending", {"ascending_nodes": NODES[::-1], "nodal_period_s": 86164}, "ephemeris.nodes", "/ascending_nodes"),
    ("repeated", {"ascending_nodes": NODES[:1] * 2, "nodal_period_s": 86164}, "ephemeris.nodes", "/ascending_nodes"),
    (
        "too close",
        {"ascending_nodes": [NODES[0], "2026-11-20T04:00:00Z"], "nodal_period_s": 86164},
        "ephemeris.nodes",
        "/ascending_nodes",
    ),
    ("period", {"ascending_nodes": NODES, "nodal_period_s": 5400}, "value.range", "/nodal_period_s"),
    ("node no instant", {"ascending_nodes": ["soon"]}, "epoch.malformed", "/ascending_nodes/0"),
    ("node a number", {"ascending_nodes": [5]}, "epoch.malformed", "/ascending_nodes/0"),
    ("node of antiquity", {"ascending_nodes": ["1980-01-01T00:00:00Z"]}, "epoch.range", "/ascending_nodes/0"),
    (
        "track unequal",
        {"ascending_nodes": NODES, "track": TRACK | {"latitude_deg": [0.0]}},
        "ephemeris.track",
        "/track",
    ),
    (
        "track descending",
        {"ascending_nodes": NODES, "track": TRACK | {"epochs": TRACK["epochs"][::-1]}},
        "ephemeris.track",
        "/track",
    ),
    (
        "track latitude",
        {"ascending_nodes": NODES, "track": TRACK | {"latitude_deg": [0, 0, 91]}},
        "value.range",
        "/track/latitude_deg/2",
    ),
    ("checksum", {"tle": [LINE_1[:-1] + str((int(LINE_1[-1]) + 1) % 10), LINE_2]}, "tle.checksum", "/tle"),
    ("form", {"tle": ["1 28089", LINE_2]}, "tle.malformed", "/tle"),
    ("three lines", {"tle": ["YAMAL", LINE_1, LINE_2]}, "value.length", "/tle"),
    ("other satellite", {"tle": [LINE_1, checked(LINE_2.replace("28089", "28090"))]}, "tle.malformed", "/tle"),
    (
        "low orbit",
        {"tle": [LINE_1, checked(LINE_2.replace(" 1.0027", "15.0027"))]},
        "ephemeris.not_geosynchronous",
        "/tle",
    ),
    ("no message", {"oem": "hello"}, "oem.malformed", "/oem"),
    ("empty message", {"oem": ""}, "oem.malformed", "/oem"),
    ("unknown field", {"ascending_nodes": NODES, "kepler": 1}, "field.unknown", "/kepler"),
]


@pytest.mark.parametrize(("body", "code", "pointer"), [case[1:] for case in BAD], ids=[case[0] for case in BAD])
async def test_bad_orbits_are_refused_by_code_and_place(soo, spacecraft, body, code, pointer):
    await soo.client.post(SC, json=spacecraft)
    soo.accepted.clear()
    answer = await soo.client.put(EPHEMERIS_URL, json=body)
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (422, code), problem
    assert problem["errors"][0]["pointer"] == pointer
    missing = await soo.client.get(EPHEMERIS_URL)
    assert (missing.status_code, missing.json()["code"]) == (404, "ephemeris.none")
    assert soo.accepted == []


async def test_an_unknown_spacecraft_is_a_404(soo):
    answer = await soo.client.put(EPHEMERIS_URL, json={"ascending_nodes": NODES})
    assert (answer.status_code, answer.json()["code"]) == (404, "spacecraft.unknown")
    assert (await soo.client.get(EPHEMERIS_URL)).json()["code"] == "spacecraft.unknown"


async def test_an_orbit_at_another_place_is_refused_unless_the_spacecraft_relocates(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    tle = {"tle": [checked(line) for line in TLE]}
    refused = await soo.client.put(EPHEMERIS_URL, json=tle)
    assert (refused.status_code, refused.json()["code"]) == (422, "ephemeris.contradicts_catalogue")
    assert refused.json()["errors"][0]["pointer"] == "/tle"
    assert (await soo.client.get(EPHEMERIS_URL)).status_code == 404
    accepted = await soo.client.put(EPHEMERIS_URL, json=tle | {"relocating": True})
    assert accepted.status_code == 200, accepted.text
    entries = (await soo.client.get("/api/v1/audit", params={"action": "put_ephemeris"})).json()["rows"]
    assert [entry["target"].rpartition("?")[2] for entry in entries if entry["outcome"] == "done"] == [
        "relocating=true"
    ]


async def test_nodes_and_tracks_are_held_against_the_catalogue_too(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    for track_deg, status in ((90.9, 200), (91.1, 422), (-269.5, 422), (-90.0, 422)):
        track = TRACK | {"longitude_deg": [track_deg if track_deg >= -180 else 360 + track_deg - 2.0] * 3}
        answer = await soo.client.put(EPHEMERIS_URL, json={"ascending_nodes": NODES, "track": track})
        assert answer.status_code == status, (track_deg, answer.text)
    for period_s, status in ((84_500.0, 200), (84_400.0, 422), (87_800.0, 200), (87_900.0, 422)):
        answer = await soo.client.put(EPHEMERIS_URL, json={"ascending_nodes": NODES[:1], "nodal_period_s": period_s})
        assert answer.status_code == status, period_s
