"""Bad input at every endpoint: one problem with a code and a pointer, never a 500.

Nothing that is refused leaves a trace, so a whole table is asked of one application.
"""

from typing import Any

import pytest

pytestmark = pytest.mark.anyio
SC = "/spacecraft/yamal-202"
WINDOW = {"start": "2026-11-17T03:00:00Z", "stop": "2026-11-19T03:00:00Z"}
EMPTY = {"start": "2026-11-17T03:00:00Z", "stop": "2026-11-17T03:00:00Z"}
SPAN = "start=2026-11-17T03:00:00Z&stop=2026-11-19T03:00:00Z"
CALIBRATION = {"quiet": WINDOW, "turns": WINDOW, "method": "paper"}
MANUAL = {
    "epoch": "2026-11-21T03:00:00Z",
    "yaw_deg": 0.5,
    "roll_deg": 0.0,
    "pitch_deg": -0.1,
    "sigma_deg": {"yaw": 0.1, "roll": 0.02, "pitch": 0.02},
    "source": "manual",
}
READ = (
    "/status",
    "/measurements",
    "/measurements/history",
    "/attitude",
    "/attitude/history",
    "/attitude/smoothed",
    "/attitude-references",
    "/corrections",
    "/telemetry",
    "/torques",
    "/torques/history",
    "/calibrations",
    "/calibrations/1",
    "/alignments",
    "/alignments/1",
    f"/harmonics?{SPAN}",
    "/carrier-selection",
    "/replays/1",
    "/stream",
    "/archive/attitude:export",
    "/archive/measurements:export",
)


async def wrong(bench, table: dict[str, tuple[str, str, dict[str, Any], tuple[Any, ...]]]) -> dict[str, Any]:
    """Return what was answered where it is not what the table says."""
    answers = {name: await bench.refused(method, path, **options) for name, (method, path, options, _) in table.items()}
    return {name: answer for name, answer in answers.items() if answer[: len(table[name][3])] != table[name][3]}


@pytest.mark.parametrize("name", ["nobody", "No-Body", "a b"])
async def test_unknown_spacecraft(bench, name):
    table = {path: ("GET", f"/spacecraft/{name}{path}", {}, (404, "spacecraft.unknown")) for path in READ}
    assert await wrong(bench, table) == {}


POSTED = {
    "/calibrations": CALIBRATION,
    "/calibrations/1:activate": None,
    "/alignments": MANUAL,
    "/replays": WINDOW,
    "/attitude-references:batch": {"source": "other", "references": []},
    "/corrections:batch": {"corrections": []},
    "/telemetry:batch": {"records": []},
}


async def test_nothing_is_started_for_an_unknown_spacecraft(bench):
    expected = (404, "spacecraft.unknown")
    table = {path: ("POST", f"/spacecraft/nobody{path}", {"json": body}, expected) for path, body in POSTED.items()}
    assert await wrong(bench, table) == {}


PAGED = ("/attitude/history", "/torques/history", "/measurements/history")
PARAMETERS = {
    "limit too small": ("limit=0", "value.range", "/query/limit"),
    "limit too great": ("limit=10001", "value.range", "/query/limit"),
    "limit no number": ("limit=many", "value.type", "/query/limit"),
    "cursor": ("cursor=AAAA", "cursor.invalid", "/query/cursor"),
    "cursor no base64": ("cursor=%C3%A9", "cursor.invalid", "/query/cursor"),
    "start": ("start=yesterday", "epoch.malformed", "/query/start"),
    "stop without offset": ("stop=2026-11-17T03:00:00", "epoch.malformed", "/query/stop"),
    "empty range": ("start=2026-11-17T03:00:00Z&stop=2026-11-17T03:00:00Z", "range.invalid", "/query/start"),
}


@pytest.mark.parametrize("path", PAGED)
async def test_bad_page(bench, path):
    table = {
        name: ("GET", f"{SC}{path}?{query}", {}, (422, code, [pointer]))
        for name, (query, code, pointer) in PARAMETERS.items()
    }
    assert await wrong(bench, table) == {}


QUERIES = {
    "attitude, method": ("/attitude?method=best", 422, "value.choice", ["/query/method"]),
    "history, method": ("/attitude/history?method=best", 422, "value.choice", ["/query/method"]),
    "history, version": ("/attitude/history?version=replay-3", 404, "replay.unknown", []),
    "history, no version": ("/attitude/history?version=dead", 404, "replay.unknown", []),
    "torques, version": ("/torques/history?version=replay-3", 404, "replay.unknown", []),
    "calibration unknown": ("/calibrations/3", 404, "calibration.unknown", []),
    "calibration no number": ("/calibrations/x", 422, "value.type", ["/path/calibration_id"]),
    "calibration great": ("/calibrations/99999999999999999999", 422, "value.range", ["/path/calibration_id"]),
    "alignment unknown": ("/alignments/3", 404, "alignment.unknown", []),
    "replay unknown": ("/replays/3", 404, "replay.unknown", []),
    "harmonics, no range": ("/harmonics", 422, "request.invalid", ["/query/start", "/query/stop"]),
    "harmonics, range": ("/harmonics?start=2026-11-17T03:00:00Z&stop=x", 422, "epoch.malformed", ["/query/stop"]),
    "harmonics, empty": (
        "/harmonics?start=2026-11-17T03:00:00Z&stop=2026-11-17T03:00:00Z",
        422,
        "range.invalid",
        ["/query/start"],
    ),
    "harmonics, carrier": (f"/harmonics?{SPAN}&carrier=c99", 404, "carrier.unknown", []),
    "harmonics, method": (f"/harmonics?{SPAN}&method=best", 422, "value.choice", ["/query/method"]),
    "selection, none": ("/carrier-selection", 409, "selection.no_calibration", []),
    "selection, optimal, none": ("/carrier-selection?rule=optimal", 409, "selection.no_calibration", []),
    "selection, turns": ("/carrier-selection?turns=many", 422, "value.choice", ["/query/turns"]),
    "selection, rule": ("/carrier-selection?rule=best", 422, "value.choice", ["/query/rule"]),
    "selection, count": ("/carrier-selection?count=4", 422, "value.range", ["/query/count"]),
    "export, series": ("/archive/powers:export", 404, "export.series_unknown", []),
    "export, format of another series": ("/archive/measurements:export?format=aem", 422, "export.format", []),
    "export, joined, format": ("/archive/joined:export?format=aem", 422, "export.format", []),
    "export, joined, method": ("/archive/joined:export?method=robust_smoothed", 422, "method.smoothed", []),
    "export, joined, version": ("/archive/joined:export?version=replay-3", 404, "replay.unknown", []),
    "export, plan": ("/archive/measurements:export?plan_id=9", 404, "plan.unknown", []),
    "export, plan number": ("/archive/measurements:export?plan_id=0", 422, "value.range", ["/query/plan_id/0"]),
    "manifest, series": ("/archive/powers:manifest", 404, "export.series_unknown", []),
    "manifest, cursor of another list": (
        "/archive/events:manifest?cursor=AgAAAAAAAAABAAAAAAAAAAEAAAAA",
        422,
        "cursor.invalid",
        ["/query/cursor"],
    ),
    "samples, count": ("/samples?quantity=roll_deg&count=0", 422, "value.range", ["/query/count"]),
    "gaps, reversed": (
        "/archive/gaps?start=2026-11-17T03:00:00Z&stop=2026-11-16T03:00:00Z",
        422,
        "range.invalid",
        ["/query/start"],
    ),
    "export, format": ("/archive/attitude:export?format=xls", 422, "value.choice", ["/query/format"]),
    "export, method": ("/archive/attitude:export?method=best", 422, "value.choice", ["/query/method"]),
    "export, version": ("/archive/attitude:export?version=replay-3", 404, "replay.unknown", []),
    "export, parameter": ("/archive/measurements:export?method=paper", 422, "export.parameter", []),
    "export, start": ("/archive/measurements:export?start=x", 422, "epoch.malformed", ["/query/start"]),
    "export, empty": (
        "/archive/attitude:export?start=2026-11-17T03:00:00Z&stop=2026-11-16T03:00:00Z",
        422,
        "range.invalid",
        ["/query/start"],
    ),
}


async def test_bad_query(bench):
    assert (
        await wrong(
            bench, {name: ("GET", SC + path, {}, tuple(reported)) for name, (path, *reported) in QUERIES.items()}
        )
        == {}
    )


async def test_unknown_job(bench):
    assert await bench.refused("GET", "/jobs/nothing") == (404, "job.unknown", [])


def without(document: dict, name: str) -> dict:
    """Return a document without a field."""
    return {key: value for key, value in document.items() if key != name}


BODIES = {
    "calibration, empty": ("/calibrations", {}, "request.invalid", ["/quiet", "/turns", "/method"]),
    "calibration, a list": ("/calibrations", [], "value.type", [""]),
    "calibration, unknown field": ("/calibrations", CALIBRATION | {"speed": 1}, "field.unknown", ["/speed"]),
    "calibration, empty window": ("/calibrations", CALIBRATION | {"turns": EMPTY}, "range.invalid", ["/turns"]),
    "calibration, epoch": (
        "/calibrations",
        CALIBRATION | {"quiet": WINDOW | {"start": "2026-11-17"}},
        "epoch.malformed",
        ["/quiet/start"],
    ),
    "calibration, epoch a number": (
        "/calibrations",
        CALIBRATION | {"quiet": WINDOW | {"start": 12}},
        "epoch.malformed",
        ["/quiet/start"],
    ),
    "calibration, century": (
        "/calibrations",
        CALIBRATION | {"quiet": WINDOW | {"start": "1999-11-17T00:00:00Z"}},
        "epoch.range",
        ["/quiet/start"],
    ),
    "calibration, method": ("/calibrations", CALIBRATION | {"method": "best"}, "value.choice", ["/method"]),
    "calibration, source": ("/calibrations", CALIBRATION | {"source": "moon"}, "value.choice", ["/source"]),
    "calibration, sources": (
        "/calibrations",
        CALIBRATION | {"sources": {"yaw": "star_tracker", "roll": "star_tracker"}},
        "field.missing",
        ["/sources/pitch"],
    ),
    "calibration, both": (
        "/calibrations",
        CALIBRATION | {"source": "other", "sources": {"yaw": "star_tracker", "roll": "star_tracker", "pitch": "other"}},
        "sources.ambiguous",
        [""],
    ),
    "alignment, empty": ("/alignments", {}, "alignment.shape", [""]),
    "alignment, both forms": ("/alignments", MANUAL | WINDOW, "alignment.shape", [""]),
    "alignment, angle missing": ("/alignments", without(MANUAL, "yaw_deg"), "alignment.shape", [""]),
    "alignment, sigma missing": ("/alignments", without(MANUAL, "sigma_deg"), "alignment.shape", [""]),
    "alignment, manual by a sensor": ("/alignments", MANUAL | {"source": "star_tracker"}, "alignment.shape", [""]),
    "alignment, stop missing": ("/alignments", without(WINDOW, "stop"), "alignment.shape", [""]),
    "alignment, empty window": ("/alignments", EMPTY, "range.invalid", [""]),
    "alignment, angle a text": ("/alignments", MANUAL | {"yaw_deg": "0.5"}, "value.type", ["/yaw_deg"]),
    "alignment, angle": ("/alignments", MANUAL | {"yaw_deg": 181.0}, "value.range", ["/yaw_deg"]),
    "alignment, sigma": (
        "/alignments",
        MANUAL | {"sigma_deg": {"yaw": 0.0, "roll": 0.1, "pitch": 0.1}},
        "value.range",
        ["/sigma_deg/yaw"],
    ),
    "alignment, source": ("/alignments", WINDOW | {"source": "moon"}, "value.choice", ["/source"]),
    "alignment, both sources": (
        "/alignments",
        WINDOW | {"source": "other", "sources": {"yaw": "other", "roll": "other", "pitch": "other"}},
        "sources.ambiguous",
        [""],
    ),
    "alignment, reason": ("/alignments", WINDOW | {"override_reason": ""}, "value.length", ["/override_reason"]),
    "alignment, unknown field": ("/alignments", WINDOW | {"quick": True}, "field.unknown", ["/quick"]),
    "replay, empty": ("/replays", {}, "request.invalid", ["/start", "/stop"]),
    "replay, empty span": ("/replays", EMPTY, "range.invalid", [""]),
    "replay, order": ("/replays", WINDOW | {"order": "random"}, "value.choice", ["/order"]),
    "replay, method": ("/replays", WINDOW | {"method": "best"}, "value.choice", ["/method"]),
    "replay, calibration": ("/replays", WINDOW | {"calibration_id": 0}, "value.range", ["/calibration_id"]),
    "replay, calibration a text": ("/replays", WINDOW | {"calibration_id": "1"}, "value.type", ["/calibration_id"]),
    "replay, unknown field": ("/replays", WINDOW | {"quick": True}, "field.unknown", ["/quick"]),
}


async def test_bad_body(bench):
    table = {
        name: ("POST", SC + path, {"json": body}, (422, code, pointers))
        for name, (path, body, code, pointers) in BODIES.items()
    }
    assert await wrong(bench, table) == {}
    assert (await bench.get("/calibrations"))["rows"] == []
    assert (await bench.get("/alignments"))["rows"] == []


@pytest.mark.parametrize("path", ["/calibrations", "/alignments", "/replays"])
async def test_body_that_is_no_document(bench, path):
    contents: dict[bytes, tuple[Any, ...]] = {
        b"": (400, "json.malformed"),
        b"{": (400, "json.malformed"),
        b"\xff": (400, "json.malformed"),
        b'{"start": NaN}': (422,),
        b'{"start": 1e999}': (422,),
    }
    headers = {"Content-Type": "application/json"}
    table = {
        repr(content): ("POST", SC + path, {"content": content, "headers": headers}, expected)
        for content, expected in contents.items()
    }
    assert await wrong(bench, table) == {}
