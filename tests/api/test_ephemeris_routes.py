"""Ephemerides in three forms; versions are kept."""

import pytest

pytestmark = pytest.mark.anyio
SC = "/api/v1/spacecraft"
URL = f"{SC}/yamal-202/ephemeris"
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
    first = await soo.client.put(URL, json={"ascending_nodes": NODES, "nodal_period_s": 86328.0})
    assert first.status_code == 200, first.text
    assert first.json() == {
        "ephemeris_id": 1,
        "ascending_nodes": NODES,
        "nodal_period_s": 86328.0,
        "valid": {"start": "2026-11-19T03:01:12.000000Z", "stop": "2026-11-22T02:57:36.000000Z"},
        "form": "nodes",
    }
    second = (await soo.client.put(URL, json={"ascending_nodes": NODES, "track": TRACK})).json()
    assert second["ephemeris_id"] == 2
    assert second["nodal_period_s"] == 86328.0, "found from the nodes"
    assert second["valid"] == {"start": TRACK["epochs"][0], "stop": TRACK["epochs"][-1]}
    assert (await soo.client.get(URL)).json() == second | {"track": TRACK}
    assert (await soo.client.get(URL, params={"ephemeris_id": 1})).json() == first.json() | {"track": None}
    assert soo.accepted == ["yamal-202", "yamal-202"]


async def test_two_line_elements_give_nodes_period_and_track(soo, spacecraft):
    site = {"latitude_deg": 50.0, "longitude_deg": 160.0}
    await soo.client.post(SC, json=spacecraft | {"longitude_deg": 180.0, "receiving_site": site})
    answer = await soo.client.put(URL, json={"tle": [checked(line) for line in TLE]})
    assert answer.status_code == 200, answer.text
    stored = (await soo.client.get(URL)).json()
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
    answer = await soo.client.put(URL, json=body)
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (422, code), problem
    assert problem["errors"][0]["pointer"] == pointer
    missing = await soo.client.get(URL)
    assert (missing.status_code, missing.json()["code"]) == (404, "ephemeris.none")
    assert soo.accepted == []


async def test_an_unknown_spacecraft_is_a_404(soo):
    answer = await soo.client.put(URL, json={"ascending_nodes": NODES})
    assert (answer.status_code, answer.json()["code"]) == (404, "spacecraft.unknown")
    assert (await soo.client.get(URL)).json()["code"] == "spacecraft.unknown"


async def test_an_orbit_at_another_place_is_refused_unless_the_spacecraft_relocates(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    tle = {"tle": [checked(line) for line in TLE]}
    refused = await soo.client.put(URL, json=tle)
    assert (refused.status_code, refused.json()["code"]) == (422, "ephemeris.contradicts_catalogue")
    assert refused.json()["errors"][0]["pointer"] == "/tle"
    assert (await soo.client.get(URL)).status_code == 404
    accepted = await soo.client.put(URL, json=tle | {"relocating": True})
    assert accepted.status_code == 200, accepted.text
    entries = (await soo.client.get("/api/v1/audit", params={"action": "put_ephemeris"})).json()["rows"]
    assert [entry["target"].rpartition("?")[2] for entry in entries if entry["outcome"] == "done"] == [
        "relocating=true"
    ]


async def test_nodes_and_tracks_are_held_against_the_catalogue_too(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    for track_deg, status in ((90.9, 200), (91.1, 422), (-269.5, 422), (-90.0, 422)):
        track = TRACK | {"longitude_deg": [track_deg if track_deg >= -180 else 360 + track_deg - 2.0] * 3}
        answer = await soo.client.put(URL, json={"ascending_nodes": NODES, "track": track})
        assert answer.status_code == status, (track_deg, answer.text)
    for period_s, status in ((84_500.0, 200), (84_400.0, 422), (87_800.0, 200), (87_900.0, 422)):
        answer = await soo.client.put(URL, json={"ascending_nodes": NODES[:1], "nodal_period_s": period_s})
        assert answer.status_code == status, period_s
