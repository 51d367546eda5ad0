"""Batches of measurements that are refused, whole or row by row, and store nothing."""

from typing import Any

import pytest

from service.records.calibration import Window
from service.records.epoch import format_epoch

pytestmark = pytest.mark.anyio
URL = "/api/v1/spacecraft/yamal-202/measurements:batch"
NOW_US = 1_795_230_000_000_000
ALL = Window(0, 4 * 10**15)


def row(offset_s: float = 0.0, powers: list[Any] | None = None, **more: Any) -> dict[str, Any]:
    """A row so many seconds after the present."""
    powers = [-42.1, None, -43.25, -60.0] if powers is None else powers
    return {"epoch": format_epoch(NOW_US + round(offset_s * 1e6)), "power_dbm": powers, **more}


def stored(soo) -> list[Any]:
    return soo.storage.archive.measurements("yamal-202", ALL, 1000, None)


def raw(measurements: str, plan_id: str = "1", more: str = "") -> str:
    return f'{{"plan_id":{plan_id},"measurements":{measurements}{more}}}'


def at(epoch: str) -> str:
    """A batch of one row with this text in place of the epoch."""
    return raw(f'[{{"epoch":"{epoch}","power_dbm":[]}}]')


def powers(text: str) -> str:
    """A batch of one row with this text in place of the powers."""
    return raw(f'[{{"epoch":"2026-11-21T02:59:59.000000Z","power_dbm":{text}}}]')


def flags(text: str) -> str:
    """A batch of one row with this text in place of the flags."""
    return powers(f'[1],"flags":{text}')


GOOD = '{"epoch":"2026-11-21T02:59:59.000000Z","power_dbm":[-1,-1,-1,-1]}'
EPOCH, POWERS, FLAGS = (f"/measurements/0/{name}" for name in ("epoch", "power_dbm", "flags"))
BAD = [
    ("empty body", "", 400, "json.malformed", None),
    ("no JSON", "plan_id=1", 400, "json.malformed", None),
    ("cut off", raw("[" + GOOD)[:-4], 400, "json.malformed", None),
    ("array", "[]", 422, "value.type", ""),
    ("null", "null", 422, "value.type", ""),
    ("text", '"plan"', 422, "value.type", ""),
    ("deep", "[" * 5000, 400, "json.malformed", None),
    ("deep inside", raw("[" * 5000 + "]" * 5000), 400, "json.malformed", None),
    ("lone surrogate", raw("[]", more=',"source":"\\ud800"'), 400, "json.malformed", None),
    ("no plan", '{"measurements":[]}', 422, "field.missing", "/plan_id"),
    ("no rows", '{"plan_id":1}', 422, "field.missing", "/measurements"),
    ("rows no array", raw("{}"), 422, "value.type", "/measurements"),
    ("unknown field", raw("[]", more=',"plan":2'), 422, "field.unknown", "/plan"),
    ("unknown row field", powers('[],"level":1'), 422, "field.unknown", "/measurements/0/level"),
    ("row no object", raw("[[]]"), 422, "value.type", "/measurements/0"),
    ("row without epoch", raw('[{"power_dbm":[]}]'), 422, "field.missing", EPOCH),
    ("row without powers", raw('[{"epoch":"2026-11-21T02:59:59.000000Z"}]'), 422, "field.missing", POWERS),
    ("NaN", powers("[1,NaN]"), 422, "value.not_finite", POWERS + "/1"),
    ("Infinity", powers("[Infinity]"), 422, "value.not_finite", POWERS + "/0"),
    ("-Infinity", powers("[-Infinity]"), 422, "value.not_finite", POWERS + "/0"),
    ("1e999", powers("[1e999]"), 422, "value.not_finite", POWERS + "/0"),
    ("power as text", powers('["-1"]'), 422, "value.type", POWERS + "/0"),
    ("power as truth", powers("[true]"), 422, "value.type", POWERS + "/0"),
    ("powers no array", powers("{}"), 422, "value.type", POWERS),
    ("flag negative", flags("[-1]"), 422, "value.range", FLAGS + "/0"),
    ("flag too large", flags("[2147483648]"), 422, "value.range", FLAGS + "/0"),
    ("flag fraction", flags("[1.5]"), 422, "value.type", FLAGS + "/0"),
    ("detail NaN", powers('[1],"c_n0_db_hz":[NaN]'), 422, "value.not_finite", "/measurements/0/c_n0_db_hz/0"),
    ("detail as text", powers('[1],"sigma_db":["0.1"]'), 422, "value.type", "/measurements/0/sigma_db/0"),
    ("detail beyond float32", powers('[1],"sigma_db":[1e39]'), 422, "value.range", "/measurements/0/sigma_db/0"),
    ("detail no array", powers('[1],"centroid_offset_hz":1'), 422, "value.type", "/measurements/0/centroid_offset_hz"),
    ("epoch a number", raw('[{"epoch":1795230000,"power_dbm":[]}]'), 422, "value.type", EPOCH),
    ("epoch no instant", at("yesterday"), 422, "epoch.malformed", EPOCH),
    ("second", raw(f'[{GOOD},{{"epoch":"now","power_dbm":[]}}]'), 422, "epoch.malformed", EPOCH.replace("0", "1")),
    ("epoch without offset", at("2026-11-21T03:00:00.000000"), 422, "epoch.malformed", EPOCH),
    ("30 February", at("2026-02-30T03:00:00.000000Z"), 422, "epoch.malformed", EPOCH),
    ("year 0", at("0000-01-01T03:00:00.000000Z"), 422, "epoch.malformed", EPOCH),
    ("other digits", at("２026-02-20T03:00:00.000000Z"), 422, "epoch.malformed", EPOCH),
    ("epoch very long", at("2" * 5000), 422, "value.length", EPOCH),
    ("plan zero", raw("[]", "0"), 422, "value.range", "/plan_id"),
    ("plan huge", raw("[]", "9" * 40), 422, "value.range", "/plan_id"),
    ("plan as text", raw("[]", '"1"'), 422, "value.type", "/plan_id"),
    ("plan fraction", raw("[]", "1.0"), 422, "value.type", "/plan_id"),
    ("plan NaN", raw("[]", "NaN"), 422, "value.type", "/plan_id"),
    ("plan unknown", raw("[" + GOOD + "]", "77"), 404, "plan.unknown", None),
    ("source with a slash", raw("[]", more=',"source":"a/b"'), 422, "value.pattern", "/source"),
    ("source empty", raw("[]", more=',"source":""'), 422, "value.pattern", "/source"),
    ("source with NUL", raw("[]", more=',"source":"a\\u0000"'), 422, "value.pattern", "/source"),
    ("seq negative", raw("[]", more=',"first_seq":-1'), 422, "value.range", "/first_seq"),
    ("seq huge", raw("[]", more=',"first_seq":99999999999999999999'), 422, "value.range", "/first_seq"),
    ("too many rows", raw("[" + ",".join([GOOD] * 201) + "]"), 422, "batch.too_long", "/measurements"),
    ("too many bytes", raw("[" + ",".join([GOOD] * 4000) + "]"), 413, "body.too_large", None),
]  # fmt: skip


@pytest.mark.parametrize(("body", "status", "code", "pointer"), [c[1:] for c in BAD], ids=[c[0] for c in BAD])
async def test_bad_batches_are_refused_whole(soo, spacecraft, carriers, body, status, code, pointer):
    assert await soo.with_plan(spacecraft, carriers) == 1
    answer = await soo.client.post(URL, content=body.encode())
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (status, code), problem
    assert answer.headers["content-type"] == "application/problem+json"
    assert set(problem) == {"type", "title", "status", "detail", "code", "next_step", "request_id", "errors"}
    assert problem["next_step"].endswith(".")
    assert problem["request_id"] == answer.headers["x-request-id"]
    if pointer is not None:
        assert problem["errors"][0]["pointer"] == pointer
    assert stored(soo) == []
    assert soo.accepted == []


async def test_invalid_utf8_is_no_json(soo, spacecraft, carriers):
    await soo.with_plan(spacecraft, carriers)
    answer = await soo.client.post(URL, content=b'{"plan_id":1,"source":"\xff","measurements":[]}')
    assert (answer.status_code, answer.json()["code"]) == (400, "json.malformed")


async def test_an_unknown_spacecraft_is_a_404(soo, spacecraft, carriers):
    await soo.with_plan(spacecraft, carriers)
    answer = await soo.client.post(URL.replace("yamal-202", "yamal-300"), content=raw("[" + GOOD + "]"))
    assert (answer.status_code, answer.json()["code"]) == (404, "spacecraft.unknown")
    assert stored(soo) == []


async def test_a_body_full_of_faults_gets_a_short_answer(soo, spacecraft, carriers):
    await soo.with_plan(spacecraft, carriers)
    answer = await soo.client.post(URL, content=raw("[" + ",".join(["0"] * 50_000) + "]"))
    assert answer.status_code == 422
    assert len(answer.content) < 10_000


@pytest.mark.parametrize("sigma_db", [-1.0, 1e15])
async def test_a_sigma_that_no_power_has_is_refused_and_nothing_is_stored(soo, spacecraft, carriers, sigma_db):
    plan_id = await soo.with_plan(spacecraft, carriers)
    body = {"plan_id": plan_id, "measurements": [row(-2), row(-1, sigma_db=[0.1, 0.1, sigma_db, 0.1])]}
    answer = await soo.client.post(URL, json=body)
    assert (answer.status_code, answer.json()["code"]) == (422, "value.range")
    assert answer.json()["errors"][0]["pointer"] == "/measurements/1/sigma_db/2"
    assert stored(soo) == []


@pytest.mark.parametrize("first_seq", [2**53, 2**53 - 1, 2**64])
async def test_sequence_numbers_that_json_cannot_keep_are_refused(soo, spacecraft, carriers, first_seq):
    plan_id = await soo.with_plan(spacecraft, carriers)
    body = {"plan_id": plan_id, "first_seq": first_seq, "measurements": [row(-2)]}
    answer = await soo.client.post(URL, json=body)
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, "/first_seq")
    assert stored(soo) == []


async def test_a_first_row_beyond_2100_is_refused_under_the_data_clock(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft | {"simulated": True}, carriers)
    soo.clock.data["yamal-202"] = None
    rows = [{"epoch": epoch, "power_dbm": [-40.0] * 4} for epoch in ("9999-01-01T00:00:00Z", "2026-11-20T00:00:00Z")]
    answer = (await soo.client.post(URL, json={"plan_id": plan_id, "measurements": rows})).json()
    assert (answer["accepted"], answer["late"]) == (1, 0)
    assert [(each["index"], each["code"]) for each in answer["refused"]] == [(0, "time.future")]
