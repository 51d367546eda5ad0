"""Batches of measurements: what is stored, counted, refused whole or row by row."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service.api.problems.next_steps import NEXT_STEPS
from service.ports.archive import ListPart
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
    return soo.storage.archive.measurements("yamal-202", ListPart(ALL, 1000))


async def test_accepted_rows_are_stored_as_sent_and_told_to_the_supervisor(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    body = {
        "plan_id": plan_id,
        "source": "sa-1",
        "first_seq": 1042,
        "measurements": [row(-2, flags=[0, 16, 0, 0]), row(-1)],
    }
    answer = await soo.client.post(URL, json=body)
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/json")
    assert answer.json() == {
        "received": 2,
        "accepted": 2,
        "duplicates": 0,
        "late": 0,
        "durable": True,
        "last_seq": 1043,
        "refused": [],
        "flagged": [],
    }
    rows = stored(soo)
    assert [(r.epoch_us, r.seq, r.source) for r in rows] == [
        (NOW_US - 2_000_000, 1042, "sa-1"),
        (NOW_US - 1_000_000, 1043, "sa-1"),
    ]
    # stored as float32, given back widened: equal bit for bit
    np.testing.assert_array_equal(rows[0].power_dbm, np.float32([-42.1, np.nan, -43.25, -60.0]).astype(float))
    assert rows[0].flags.tolist() == [0, 16, 0, 0]
    assert rows[1].flags is None
    assert soo.accepted == ["yamal-202"]


async def test_every_kind_of_row_is_counted_once(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    await soo.client.post(URL, json={"plan_id": plan_id, "source": "s", "measurements": [row(-10), row(-9)]})
    rows = [
        row(-10),  # duplicate
        row(-9, [-1.0, None, -43.25, -60.0]),  # conflict
        row(6),  # future
        row(-8, [None] * 4),  # a row of only nulls is a row
        row(-7, [-42.0]),  # count
        row(-6, [-250.01, None, None, None]),  # range
        row(-5, [50.01, None, None, None]),
        row(-4, [-250.0, 50.0, None, 0]),  # the ends belong to the range
        row(-400),  # late
        {"epoch": "1999-12-31T23:59:59.999999Z", "power_dbm": [None] * 4},
        row(-3, flags=[0]),
    ]
    soo.accepted.clear()
    answer = (
        await soo.client.post(URL, json={"plan_id": plan_id, "source": "s", "first_seq": 7, "measurements": rows})
    ).json()
    assert answer["received"] == answer["accepted"] + answer["duplicates"] + len(answer["refused"])
    assert (answer["accepted"], answer["duplicates"], answer["late"], answer["last_seq"]) == (3, 1, 1, 17)
    assert [(r["index"], r["seq"], r["code"]) for r in answer["refused"]] == [
        (1, 8, "measurement.conflict"),
        (2, 9, "time.future"),
        (4, 11, "value.count"),
        (5, 12, "value.out_of_range"),
        (6, 13, "value.out_of_range"),
        (9, 16, "time.too_old"),
        (10, 17, "value.count"),
    ]
    assert all(r["detail"] and r["next_step"] == NEXT_STEPS[r["code"]] for r in answer["refused"])
    assert [r.epoch_us for r in stored(soo)] == [NOW_US + s * 1_000_000 for s in (-400, -10, -9, -8, -4)]
    assert soo.accepted == ["yamal-202"]


async def test_the_same_after_rounding_to_float32_is_a_duplicate(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    for power in (-42.1, float(np.float32(-42.1))):
        body = {"plan_id": plan_id, "measurements": [row(-1, [power, None, None, None])]}
        answer = (await soo.client.post(URL, json=body)).json()
    assert (answer["accepted"], answer["duplicates"]) == (0, 1)
    assert len(stored(soo)) == 1


async def test_details_are_kept_with_the_row_and_told_in_the_history(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    detailed = row(
        -3,
        sigma_db=[0.05, None, 0.06, 0.07],
        c_n0_db_hz=[71.3, None, 70.1, 69.9],
        centroid_offset_hz=[-1250.5, None, 0, 12],
    )
    body = {"plan_id": plan_id, "measurements": [detailed, row(-2), row(-1, sigma_db=[None] * 4)]}
    assert (await soo.client.post(URL, json=body)).json()["accepted"] == 3
    first, second, third = (await soo.client.get(URL.replace(":batch", "/history"))).json()["rows"]
    assert first["measured_sigma_db"] == {"c00": 0.05, "c01": None, "c02": 0.06, "b0": 0.07}
    assert first["c_n0_db_hz"]["c00"] == 71.3
    assert first["centroid_offset_hz"] == {"c00": -1250.5, "c01": None, "c02": 0.0, "b0": 12.0}
    assert first["occupied_bandwidth_hz"] is None
    for plain in (second, third):
        assert plain["measured_sigma_db"] is plain["c_n0_db_hz"] is plain["centroid_offset_hz"] is None


async def test_a_wrong_number_of_details_refuses_the_row_and_names_the_figure(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    body = {"plan_id": plan_id, "measurements": [row(-2), row(-1, sigma_db=[0.1] * 4, c_n0_db_hz=[70.0] * 3)]}
    answer = (await soo.client.post(URL, json=body)).json()
    assert (answer["accepted"], len(answer["refused"])) == (1, 1)
    (refusal,) = answer["refused"]
    assert (refusal["index"], refusal["code"]) == (1, "value.count")
    assert "3 of c_n0_db_hz" in refusal["detail"]


async def test_a_batch_of_nothing_and_a_batch_of_refused_rows_store_nothing(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    for rows, refused in (([], 0), ([row(60)], 1)):
        answer = (await soo.client.post(URL, json={"plan_id": plan_id, "measurements": rows})).json()
        assert (answer["received"], answer["accepted"], len(answer["refused"])) == (len(rows), 0, refused)
        assert answer["last_seq"] is None
    assert stored(soo) == []
    assert soo.accepted == []


async def test_under_the_data_clock_age_makes_nothing_late_and_the_future_is_thirty_days_away(
    soo, spacecraft, carriers
):
    plan_id = await soo.with_plan(spacecraft, carriers)
    soo.clock.data["yamal-202"] = None
    body = {"plan_id": plan_id, "measurements": [row(-3 * 365 * 86_400)]}
    first = (await soo.client.post(URL, json=body)).json()
    assert (first["accepted"], first["late"]) == (1, 0), "nothing bounds the first row"
    soo.clock.data["yamal-202"] = NOW_US
    body["measurements"] = [row(-1000), row(30 * 86_400), row(30 * 86_400 + 1)]
    second = (await soo.client.post(URL, json=body)).json()
    assert (second["accepted"], second["late"]) == (2, 0)
    assert [r["code"] for r in second["refused"]] == ["time.future"]


async def test_offsets_and_other_forms_of_the_same_instant_are_understood(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    epochs = ["2026-11-21T02:59:58Z", "2026-11-21t02:59:57.5z", "2026-11-21T05:59:59.000000+03:00"]
    rows = [{"epoch": epoch, "power_dbm": [None] * 4} for epoch in epochs]
    answer = (await soo.client.post(URL, json={"plan_id": plan_id, "measurements": rows})).json()
    assert answer["accepted"] == 3, answer
    assert [format_epoch(r.epoch_us)[17:] for r in stored(soo)] == ["57.500000Z", "58.000000Z", "59.000000Z"]


async def test_an_older_plan_is_accepted_from_memory_and_from_the_archive(soo, spacecraft, carriers):
    first = await soo.with_plan(spacecraft, carriers)
    second = (await soo.client.put("/api/v1/spacecraft/yamal-202/carriers", json={"carriers": carriers[:2]})).json()[
        "plan_id"
    ]
    assert second != first
    for k, (plan_id, width) in enumerate([(first, 4), (second, 2), (first, 4)]):
        body = {"plan_id": plan_id, "measurements": [row(-9 + k, [-40.0] * width)]}
        assert (await soo.client.post(URL, json=body)).json()["accepted"] == 1


async def test_sources_are_listed_and_selected(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    base = "/api/v1/spacecraft/yamal-202/sources"
    assert (await soo.client.get(base)).json()["rows"] == []
    for source, offset in (("sa-1", -2), ("sa:2", -1)):
        await soo.client.post(URL, json={"plan_id": plan_id, "source": source, "measurements": [row(offset)]})
    rows = (await soo.client.get(base)).json()["rows"]
    assert [(r["id"], r["role"], r["rows"]) for r in rows] == [("sa-1", "prime", 1), ("sa:2", "backup", 1)]
    assert rows[1]["newest_epoch"] == format_epoch(NOW_US - 1_000_000)
    soo.accepted.clear()
    answer = await soo.client.post(f"{base}/sa:2:select")
    assert (answer.status_code, answer.json()["role"]) == (200, "prime")
    assert soo.accepted == ["yamal-202"]
    for name in ("sa-9", "%00", "a%20b", "x" * 500):
        unknown = await soo.client.post(f"{base}/{name}:select")
        assert (unknown.status_code, unknown.json()["code"]) == (404, "source.unknown")
    assert [r["role"] for r in (await soo.client.get(base)).json()["rows"]] == ["backup", "prime"]


async def test_a_leap_second_is_stored_in_the_second_after_it_and_flagged(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    texts = ["2016-12-31T23:59:59.5Z", "2016-12-31T23:59:60.5Z", "2017-01-01T00:00:00.5Z", "2017-01-01T00:00:01Z"]
    rows = [{"epoch": text, "power_dbm": [-40.0 - position] * 4} for position, text in enumerate(texts)]
    rows[0]["flags"] = rows[1]["flags"] = [0, 1, 0, 0]
    body = {"plan_id": plan_id, "measurements": rows}
    answer = (await soo.client.post(URL, json=body)).json()
    assert (answer["accepted"], answer["refused"]) == (4, [])
    assert [(each["index"], each["code"]) for each in answer["flagged"]] == [
        (1, "time.leap_second"),
        (2, "time.leap_second"),
    ]
    assert (await soo.client.post(URL, json=body)).json()["duplicates"] == 4
    leap = 1 << 23
    assert [(format_epoch(each.epoch_us)[17:], each.flags.tolist()) for each in stored(soo)[1:3]] == [
        ("00.500000Z", [leap, leap + 1, leap, leap]),
        ("00.500001Z", [leap] * 4),
    ]


async def test_the_flag_of_a_leap_second_is_not_for_clients(soo, spacecraft, carriers):
    """Such a row was stored 1 us past the row whose epoch it states, beside it."""
    plan_id = await soo.with_plan(spacecraft, carriers)
    leap = 1 << 23
    rows = [row(-3), row(-2, flags=[0, leap + 1, 0, 0]), row(-1, flags=[1 << 24, 0, 0, 0])]
    answer = (await soo.client.post(URL, json={"plan_id": plan_id, "measurements": rows})).json()
    assert (answer["accepted"], [(each["index"], each["code"]) for each in answer["refused"]]) == (
        2,
        [(1, "flag.reserved")],
    )
    assert answer["refused"][0]["next_step"] == NEXT_STEPS["flag.reserved"]


async def test_the_first_batch_of_a_simulated_spacecraft_bounds_itself(soo, spacecraft, carriers):
    """One epoch of 2099 among the first rows ended the clock of the data: all that followed was late."""
    plan_id = await soo.with_plan({**spacecraft, "simulated": True}, carriers)
    soo.clock.data["yamal-202"] = None
    days = [
        row(0),
        row(366 * 86_400),
        row(366 * 86_400 + 1),
        {"epoch": "2099-12-31T00:00:00Z", "power_dbm": [None] * 4},
    ]
    answer = (await soo.client.post(URL, json={"plan_id": plan_id, "measurements": days})).json()
    assert (answer["accepted"], [(each["index"], each["code"]) for each in answer["refused"]]) == (
        2,
        [(2, "time.future"), (3, "time.future")],
    )


async def test_digits_beyond_the_nanosecond_are_rounded(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    rows = [{"epoch": "2026-11-20T00:00:00.0000014999999999Z", "power_dbm": [-40.0] * 4}]
    assert (await soo.client.post(URL, json={"plan_id": plan_id, "measurements": rows})).json()["accepted"] == 1
    assert format_epoch(stored(soo)[0].epoch_us) == "2026-11-20T00:00:00.000001Z"


async def test_a_key_makes_a_bounded_number_of_sources(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    limits = replace(soo.app.state.context.limits, max_sources_per_key=2)
    object.__setattr__(soo.app.state.context, "limits", limits)
    answers = [
        await soo.client.post(URL, json={"plan_id": plan_id, "source": f"s-{k}", "measurements": [row(k - 9)]})
        for k in (0, 1, 2, 1)
    ]
    assert [answer.status_code for answer in answers[:2]] == [200, 200]
    assert (answers[2].status_code, answers[2].json()["code"]) == (422, "source.too_many")
    # the last one is known, and its row a duplicate
    assert answers[3].json()["duplicates"] == 1
    assert len(stored(soo)) == 2


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
    ("cut off", raw("[" + GOOD)[:-4], 400, "json.malformed", None),
    ("array", "[]", 422, "value.type", ""),
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
    ("1e999", powers("[1e999]"), 422, "value.not_finite", POWERS + "/0"),
    ("power as text", powers('["-1"]'), 422, "value.type", POWERS + "/0"),
    ("power as truth", powers("[true]"), 422, "value.type", POWERS + "/0"),
    ("powers no array", powers("{}"), 422, "value.type", POWERS),
    ("flag negative", flags("[-1]"), 422, "value.range", FLAGS + "/0"),
    ("flag too large", flags("[2147483648]"), 422, "value.range", FLAGS + "/0"),
    ("flag fraction", flags("[1.5]"), 422, "value.type", FLAGS + "/0"),
    ("detail NaN", powers('[1],"c_n0_db_hz":[NaN]'), 422, "value.not_finite", "/measurements/0/c_n0_db_hz/0"),
    ("detail as text", powers('[1],"sigma_db":["0.1"]'), 422, "value.type", "/measurements/0/sigma_db/0"),
    ("sigma of no power", powers('[1],"sigma_db":[1001]'), 422, "value.range", "/measurements/0/sigma_db/0"),
    ("sigma negative", powers('[1],"sigma_db":[-1]'), 422, "value.range", "/measurements/0/sigma_db/0"),
    ("detail no array", powers('[1],"centroid_offset_hz":1'), 422, "value.type", "/measurements/0/centroid_offset_hz"),
    ("epoch a number", raw('[{"epoch":1795230000,"power_dbm":[]}]'), 422, "value.type", EPOCH),
    ("epoch no instant", at("yesterday"), 422, "epoch.malformed", EPOCH),
    ("second", raw(f'[{GOOD},{{"epoch":"now","power_dbm":[]}}]'), 422, "epoch.malformed", EPOCH.replace("0", "1")),
    ("epoch without offset", at("2026-11-21T03:00:00.000000"), 422, "epoch.malformed", EPOCH),
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
    ("seq beyond what JSON keeps", raw("[]", more=',"first_seq":9007199254740992'), 422, "value.range", "/first_seq"),
    ("seq after", raw(f"[{GOOD}]", more=',"first_seq":9007199254740991'), 422, "value.range", "/first_seq"),
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
