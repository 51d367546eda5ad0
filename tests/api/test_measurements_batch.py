"""Batches of measurements: what is stored, counted, refused, and what nothing is stored of."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service.api.problems.next_steps import NEXT_STEPS
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


async def test_accepted_rows_are_stored_as_sent_and_told_to_the_supervisor(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    body = {
        "plan_id": plan_id,
        "source": "sa-1",
        "first_seq": 1042,
        "measurements": [row(-2, flags=[0, 16, 0, 0]), row(-1)],
    }
    answer = await soo.client.post(URL, json=body)
    assert answer.status_code == 200
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


async def test_other_details_of_a_known_row_are_a_conflict(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    for sigma_db in ([0.1] * 4, [0.2] * 4):
        body = {"plan_id": plan_id, "measurements": [row(-1, sigma_db=sigma_db)]}
        answer = (await soo.client.post(URL, json=body)).json()
    assert [refusal["code"] for refusal in answer["refused"]] == ["measurement.conflict"]
    # the first ones stay
    assert stored(soo)[0].details.sigma_db.tolist() == np.float32([0.1] * 4).tolist()


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
    body = {"plan_id": plan_id, "measurements": [row(-3 * 365 * 86_400), row(50 * 365 * 86_400)]}
    first = (await soo.client.post(URL, json=body)).json()
    assert (first["accepted"], first["late"]) == (2, 0), "nothing bounds the first row"
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


async def test_the_receipt_is_plain_json(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    answer = await soo.client.post(URL, json={"plan_id": plan_id, "measurements": [row(-1)]})
    assert answer.headers["content-type"] == "application/json"
    assert json.loads(answer.content)["durable"] is True


async def test_a_jump_of_sequence_numbers_is_stored_and_flagged(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    for offset_s, first_seq in ((-2, 7), (-1, 2**52)):
        body = {"plan_id": plan_id, "first_seq": first_seq, "measurements": [row(offset_s)]}
        answer = (await soo.client.post(URL, json=body)).json()
    assert answer["accepted"] == 1
    assert [(each["code"], each["seq"]) for each in answer["flagged"]] == [("seq.jump", 2**52)]


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
    # one by one, in whichever order they come
    single = {"plan_id": plan_id, "source": "sa-2"}
    for each in (rows[2], rows[1], rows[2], rows[1]):
        answer = (await soo.client.post(URL, json={**single, "measurements": [each]})).json()
    assert answer["duplicates"] == 1


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
