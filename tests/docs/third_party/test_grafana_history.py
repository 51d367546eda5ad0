"""Queries of the page on Grafana, sent as Infinity sends them and read as Infinity's backend reads rows by columns."""

import json
import os
import re
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from release_ground import ReleaseGround, record, seed_archive
from service_process import KEY, serving_on

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "how-to" / "show-history-in-grafana.md").read_text()
ROLL_DEG, TURNED_ROWS = 0.2, 20


def blocks(language: str) -> list[str]:
    """Return the blocks of the page in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ReleaseGround]:
    """Give a station whose spacecraft was turned about roll after its alignment."""
    database = tmp_path_factory.mktemp("grafana") / "soo.db"
    seed_archive(f"sqlite:///{database}", record("yamal-202"))
    with serving_on(database, os.environ) as service, service.client() as client:
        station = ReleaseGround(client, "yamal-202")
        station.align()
        station.rows(TURNED_ROWS, (0.0, ROLL_DEG, 0.0))
        yield station


@pytest.fixture(scope="module")
def sent(ground: ReleaseGround) -> Iterator[httpx.Client]:
    """Give what the provisioned source adds to each query: its address and the key."""
    (source,) = yaml.safe_load(blocks("yaml")[0])["datasources"]
    environment = {"SOO_URL": str(ground.client.base_url).rstrip("/"), "SOO_KEY": KEY}
    assert source["jsonData"]["auth_method"] == "bearerToken"
    assert source["jsonData"]["allowedHosts"] == [source["url"]]
    key = environment[source["secureJsonData"]["bearerToken"].removeprefix("$")]
    url = environment[source["url"].removeprefix("$")]
    headers = {"Authorization": f"Bearer {key}"}
    with httpx.Client(base_url=url, headers=headers, timeout=120.0, trust_env=False) as client:
        yield client


def queries() -> list[dict[str, Any]]:
    """Return the queries of the page."""
    return [json.loads(text) for text in blocks("json")]


def gjson(path: str, answer: Any) -> list[Any]:
    """Return what a path of GJSON selects: names and positions to a list, or named lists that are joined to rows."""
    multiple = re.fullmatch(r"\{(.+)\}\|@group", path)
    if multiple is None:
        for name in path.split("."):
            answer = answer[int(name) if name.isdecimal() else name]
        assert isinstance(answer, list)
        return answer
    # the last part of a path is its name where none is stated
    parts = [part.rpartition(":") for part in multiple.group(1).split(",")]
    columns = {name.strip('"') or of.rpartition(".")[2]: gjson(of, answer) for name, _, of in parts}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def infinity_rows(query: dict[str, Any], answer: Any) -> list[dict[str, Any]]:
    """Return the columns of a query: rows of the root, selectors in each, values by their types."""
    types = {"timestamp": datetime.fromisoformat, "number": float, "string": str}
    return [
        {each["text"]: types[each["type"]](row[each["selector"]]) for each in query["columns"]}
        for row in gjson(query["root_selector"], answer)
    ]


def ask(sent: httpx.Client, ground: ReleaseGround, query: dict[str, Any], **others: str) -> list[dict[str, Any]]:
    """Send a query for the last hour, as the macros of the span put it, and return its rows."""
    # the macros give milliseconds
    ends = [re.sub(r"\d{3}Z$", "Z", ground.epoch(late_s)) for late_s in (-3600, 60)]
    span = dict(zip(("${__timeFrom:date:iso}", "${__timeTo:date:iso}"), ends, strict=True))
    params = {each["key"]: span.get(each["value"], each["value"]) for each in query["url_options"]["params"]}
    assert [params["start"], params["stop"]] == ends
    answer = sent.request(query["url_options"]["method"], query["url"], params={**params, **others})
    assert answer.status_code == 200, answer.text
    return infinity_rows(query, answer.json())


def test_queries_are_of_the_provisioned_source() -> None:
    (source,) = yaml.safe_load(blocks("yaml")[0])["datasources"]
    assert [query["refId"] for query in queries()] == ["Roll", "Power", "States"]
    for query in queries():
        assert query["datasource"] == {"type": source["type"], "uid": source["uid"]}
        assert (query["type"], query["parser"], query["source"]) == ("json", "backend", "url")
        kinds = [each["type"] for each in query["columns"]]
        assert kinds[0] == "timestamp"
        assert query["format"] == ("timeseries" if "number" in kinds else "table")


@pytest.mark.parametrize(("axis", "truth_deg"), [("roll_deg", ROLL_DEG), ("pitch_deg", 0.0)])
def test_angles_follow_the_turn(sent, ground, axis, truth_deg) -> None:
    rows = ask(sent, ground, queries()[0], quantity=axis)
    assert len(rows) == TURNED_ROWS
    times = [row["time"] for row in rows]
    assert times == sorted(times)
    assert rows[-1]["roll, deg"] == pytest.approx(truth_deg, abs=0.05)
    assert all(row["least"] <= row["roll, deg"] <= row["greatest"] for row in rows)


def test_powers_are_those_that_were_sent(sent, ground) -> None:
    rows = ask(sent, ground, queries()[1])
    held = {carrier["carrier"]: carrier for carrier in ground.get("/measurements")}
    assert rows[-1]["c00, dBm"] == pytest.approx(held["c00"]["power_dbm"])


def test_states_have_begin_end_and_name(sent, ground) -> None:
    rows = ask(sent, ground, queries()[2])
    assert {"status", "inhibition"} <= {row["kind"] for row in rows}
    assert all(row["time"] <= row["timeEnd"] and row["title"] for row in rows)


def test_refusals_that_the_page_names(sent, ground) -> None:
    assert sent.get("/api/v1/spacecraft/nobody/timeline").json()["code"] == "spacecraft.unknown"
    wrong = httpx.get(f"{sent.base_url}/api/v1/spacecraft", headers={"Authorization": "Bearer x"}, trust_env=False)
    assert (wrong.status_code, wrong.json()["code"]) == (401, "key.invalid")
    assert "| 401 `key.invalid` |" in PAGE
    assert "| 404 `spacecraft.unknown` |" in PAGE
