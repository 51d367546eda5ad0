"""Live series of smoothed rows: a version of its own for histories, samples, exports and the stream."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
from served_stream import Reader, Served, serving

from service.ports import SMOOTHED, Outcome
from service.records.catalogue import Method

pytestmark = pytest.mark.anyio
OF_SERIES = {"version": SMOOTHED, "method": "robust_smoothed"}


@pytest.fixture
def served(bench, make) -> Iterator[Served]:
    with serving(bench.app, make.key) as served:
        yield served


@pytest.fixture
def store(bench, make):
    """Return what stores smoothed rows of measurements some minutes old."""

    def store(*minutes):
        rows = bench.append([make.now_us - minute * 60 * make.s for minute in minutes])
        made = [
            replace(make.row(row, method=Method.ROBUST_SMOOTHED), lag_s=7200.0, control_allowed=False) for row in rows
        ]
        outcomes = [Outcome((row,), None) for row in made]
        bench.storage.results.save_outcomes(make.sc, SMOOTHED, outcomes, 0, None)
        return made

    return store


async def test_the_series_is_listed_page_by_page_in_both_orders(bench, store):
    assert (await bench.get("/attitude/smoothed"))["rows"] == []
    made = store(30, 25, 20)
    first = await bench.get("/attitude/smoothed", limit=2)
    rest = await bench.get("/attitude/smoothed", limit=2, cursor=first["next"])
    rows = first["rows"] + rest["rows"]
    assert (len(first["rows"]), rest["next"]) == (2, None)
    assert [row["roll_deg"] for row in rows] == [row.attitude_deg.roll for row in made]
    assert {(row["method"], row["version"], row["lag_s"]) for row in rows} == {("robust_smoothed", SMOOTHED, 7200.0)}
    assert not any(row["control_allowed"] for row in rows)
    assert (first["method"], first["version"]) == ("robust_smoothed", SMOOTHED)
    backward = await bench.get("/attitude/smoothed", order="desc")
    assert backward["rows"] == rows[::-1]
    # the same rows under the general names
    assert (await bench.get("/attitude/history", **OF_SERIES))["rows"] == rows


async def test_samples_and_exports_have_them(bench, store):
    made = store(30, 25, 20)
    samples = await bench.get("/samples", quantity="roll_deg", count=10, **OF_SERIES)
    assert "robust_smoothed" in str(samples)
    answer = await bench.client.get(f"{bench.url}/archive/attitude:export", params={"format": "csv", **OF_SERIES})
    assert answer.status_code == 200, answer.text
    lines = [line for line in answer.text.splitlines() if line and not line.startswith("#")]
    assert len(lines) == len(made) + 1
    assert "attitude_robust_smoothed_smoothed" in answer.headers["content-disposition"]


async def test_nothing_of_the_present_is_touched(bench, make, store):
    before = await bench.get("/attitude")
    head = bench.storage.archive.head(make.sc)
    made = store(30)
    assert bench.storage.archive.head(make.sc).result_sequence == head.result_sequence
    after = await bench.get("/attitude")
    assert (after["method"], after["version"]) == (before["method"], before["version"])
    assert after["control"]["allowed"] is before["control"]["allowed"]
    assert (await bench.get("/torques/history", version=SMOOTHED))["rows"] == []
    assert len(made) == 1


@pytest.mark.parametrize("path", ["attitude/history", "archive/attitude:export", "samples"])
async def test_other_methods_have_no_rows_in_it(bench, store, path):
    store(30)
    for method in ("robust", "paper"):
        query = {"version": SMOOTHED, "method": method, "quantity": "roll_deg", "format": "csv"}
        answer = await bench.client.get(f"{bench.url}/{path}", params=query)
        assert (answer.status_code, answer.json()["code"]) == (422, "method.smoothed"), path
        assert "has rows of method robust_smoothed alone" in answer.text


async def test_an_unknown_spacecraft_has_no_series(bench):
    answer = await bench.client.get("/api/v1/spacecraft/nobody/attitude/smoothed")
    assert (answer.status_code, answer.json()["code"]) == (404, "spacecraft.unknown")


async def test_the_stream_sends_each_new_row_as_the_list_has_it(served, bench, store):
    store(40)
    with served.open(None, "status", "smoothed") as response:
        reader = Reader(response)
        # what there is at the first look is no change
        reader.consume(1, "status")
        store(35, 30)
        events = reader.consume(2)
    rows = (await bench.get("/attitude/smoothed"))["rows"]
    assert [event.kind for event in events] == ["smoothed", "smoothed"]
    assert [event.data for event in events] == rows[1:]
