"""Readiness names what is not ready, metrics tell archive, estimator and interface, every request has its line."""

import json
import logging
import re
from dataclasses import replace

import pytest
from prometheus_client.parser import text_string_to_metric_families

from service.api.monitoring.metrics import FAMILIES
from service.errors import StorageError
from service.ports.archive import Outcome
from service.records.inputs import Correction, TelemetryRecord
from service.records.levels.attitude import Axes, CarrierState
from service.records.operations.work import LinkReport
from service.runtime.live.journal_consumer import Restarting
from service.runtime.log_format import JsonLogFormatter

pytestmark = pytest.mark.anyio


def samples(text: str) -> dict[tuple[str, ...], float]:
    """Return values by name and values of labels, in the order in which they are declared."""
    reported = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            known = FAMILIES.get(sample.name) or FAMILIES[re.sub(r"_(bucket|count|sum)$", "", sample.name)]
            names = [*known.labels, *(["le"] if sample.name.endswith("_bucket") else [])]
            assert sorted(names) == sorted(sample.labels)
            reported[sample.name, *(sample.labels[name] for name in names)] = sample.value
    return reported


def change(bench, **changes) -> None:
    """Change what the context of the application holds."""
    for name, value in changes.items():
        object.__setattr__(bench.context, name, value)


async def unready(bench) -> dict:
    """Return the problem of a service that is not ready."""
    answer = await bench.client.get("/readyz", headers={"Authorization": ""})
    assert answer.status_code == 503
    assert answer.headers["retry-after"] == "5"
    assert answer.headers["content-type"] == "application/problem+json"
    return answer.json()


async def test_a_ready_service_tells_its_parts(bench):
    answer = await bench.client.get("/readyz", headers={"Authorization": ""})
    assert answer.status_code == 200
    assert [part["name"] for part in answer.json()["parts"]] == ["database", "disk", "consumers"]


async def test_a_service_that_catches_up_is_ready_and_says_how_long_it_takes(bench, make, monkeypatch):
    assert (await bench.client.get("/readyz")).json()["catching_up"] is None
    bench.append([make.now_us + k * make.s for k in range(5)])
    change(bench, monitoring=replace(bench.context.monitoring, ready_lag=3))
    monkeypatch.setattr(bench.context.supervisor.restarts, "under_way", Restarting("yamal-202", 1200, 1.5))
    answer = await bench.client.get("/readyz")
    assert answer.status_code == 200
    assert answer.json()["catching_up"] == {"spacecraft": "yamal-202", "rows_left": 1200, "seconds_left": 1.5}


async def test_a_ready_service_tells_who_leads(bench):
    assert (await bench.client.get("/readyz")).json()["leaders"] == []
    change(bench, leaders=lambda: {"": "host-2:7", "yamal-202": "host-1:7"})
    leaders = (await bench.client.get("/readyz")).json()["leaders"]
    assert leaders == [{"spacecraft": "yamal-202", "process": "host-1:7"}]


async def test_an_estimator_that_is_behind_is_named(bench, make):
    bench.append([make.now_us + k * make.s for k in range(5)])
    change(bench, monitoring=replace(bench.context.monitoring, ready_lag=3))
    problem = await unready(bench)
    assert problem["code"] == "consumers.behind"
    assert "yamal-202 by " in problem["detail"]
    assert problem["errors"][0]["pointer"] == "/consumers"
    bench.consume()
    assert (await bench.client.get("/readyz")).status_code == 200


async def test_an_estimator_that_fails_is_not_ready_and_the_status_says_so_first(bench, make):
    (row,) = bench.append([make.now_us])
    bench.consume([Outcome((make.row(row, inhibitions=("fade",), control_allowed=False),), None)])
    for _ in range(3):
        bench.context.supervisor.failures.note(make.sc, "step", "UnpicklingError: pickle data was truncated")
    problem = await unready(bench)
    assert problem["code"] == "estimator.failed"
    assert problem["errors"][0]["pointer"] == "/estimator"
    assert re.search(rf"{make.sc} failed 3 times since 20.*, first: UnpicklingError: pickle", problem["detail"])
    (first, *_) = (await bench.client.get(f"{bench.url}/status")).json()["control"]["reasons"]
    assert first["code"] == "estimator_failed"
    assert "UnpicklingError: pickle data was truncated" in first["text"]
    assert samples((await bench.client.get("/metrics")).text)["soo_ready", "estimator"] == 0.0
    bench.context.supervisor.failures.forget(make.sc, "step")
    assert (await bench.client.get("/readyz")).status_code == 200


async def test_a_service_beside_a_leader_that_is_silent_is_not_ready(bench):
    change(bench, leader_silent_s=lambda: 29.0)
    assert (await bench.client.get("/readyz")).status_code == 200
    change(bench, leader_silent_s=lambda: 41.0)
    problem = await unready(bench)
    assert (problem["code"], problem["errors"][0]["pointer"]) == ("leader.silent", "/leader")
    assert "for 41 s" in problem["detail"]


async def test_a_document_that_cannot_be_read_takes_nothing_else_away(bench, make):
    """A key of a calibration was written otherwise: no request fails by more than a problem with its code."""
    (row,) = bench.append([make.now_us])
    bench.consume([Outcome((make.row(row),), make.command(row))])
    bench.calibrate([make.carrier_calibration(0, Axes(0.1, -0.3, 0.4))])
    bench.align(make.now_us - make.s)
    with bench.storage._database.engines.write.begin() as connection:
        connection.exec_driver_sql("""UPDATE calibration SET request = replace(request, '"method"', '"way"')""")
        connection.exec_driver_sql("""UPDATE alignment SET document = replace(document, '"source"', '"from"')""")
    paths = ["status", "attitude", "control", "torques", "calibrations", "alignments", "sources", "carriers"]
    for path in paths:
        answer = await bench.client.get(f"{bench.url}/{path}")
        code = answer.json().get("code") if answer.status_code != 200 else None
        assert (answer.status_code, code) in ((200, None), (503, "storage.corrupt"), (404, code)), path
    assert (await bench.client.get(f"{bench.url}/status")).status_code == 200
    reported = samples((await bench.client.get("/metrics")).text)
    assert reported["soo_attitude_deg", make.sc, "paper", "roll"] == -0.02
    assert reported["soo_journal_lag", make.sc] == 2.0


async def test_a_damaged_slow_input_is_refused_in_its_list_alone(bench, make):
    at_us = make.now_us
    sent = [TelemetryRecord(at_us, "hold"), Correction(at_us, at_us + make.s, Axes(0.1, 0.0, 0.0))]
    bench.storage.archive.append_inputs(make.sc, sent)
    with bench.storage._database.engines.write.begin() as connection:
        connection.exec_driver_sql(
            "UPDATE journal SET document = replace(document, 'hold', 'sun') WHERE kind = 'telemetry'"
        )
    answer = await bench.client.get(f"{bench.url}/telemetry")
    assert (answer.status_code, answer.json()["code"]) == (503, "storage.corrupt")
    assert "journal row of" in answer.json()["detail"]
    assert (await bench.client.get(f"{bench.url}/corrections")).status_code == 200


async def test_a_sign_changed_in_a_calibration_stops_control_and_the_calibration_is_named(bench, make):
    (row,) = bench.append([make.now_us])
    bench.consume([Outcome((make.row(row),), make.command(row))])
    calibration = bench.calibrate([make.carrier_calibration(0, Axes(0.1, -0.3, 0.4))])
    bench.align(make.now_us - make.s)
    before = await bench.get("/control")
    assert "document_corrupt" not in before["reasons"]
    with bench.storage._database.engines.write.begin() as connection:
        changed = connection.exec_driver_sql("UPDATE calibration SET result = replace(result, '-0.3', '0.3')").rowcount
    assert changed == 1
    # facts of the archive are read again after 20 s, or when an input comes in
    bench.context.release_service.on_rows(make.sc, (), has_inputs=True)
    control = await bench.get("/control")
    assert (control["state"], control["control"]["allowed"]) == ("TRIPPED", False)
    assert control["withheld"]
    (reason,) = [each for each in control["control"]["reasons"] if each["code"] == "document_corrupt"]
    assert reason["text"].endswith(f"differs from its digest: calibration {calibration.id}")
    # the chain learns of it from the journal, as a replay does
    (entry,) = bench.storage.archive.slow_inputs_before(make.sc, 1 << 62, ("interlock",))
    assert (entry.content.is_withheld, entry.content.reasons[0]) == (True, "document_corrupt")
    bench.context.alarms._check_clock()
    alarms = (await bench.get("/alarms"))["rows"]
    alarm = next(each for each in alarms if each["condition"] == "document_corrupt")
    assert (alarm["severity"], alarm["thing"]) == ("critical", f"calibration {calibration.id}")
    with bench.storage._database.engines.write.begin() as connection:
        connection.exec_driver_sql("UPDATE calibration SET result = '{'")
    bench.context.release_service.on_rows(make.sc, (), has_inputs=True)
    # what cannot be read is named as well, and control stays tripped
    assert (await bench.get("/control"))["state"] == "TRIPPED"
    problem = (await bench.client.get(f"{bench.url}/calibrations/{calibration.id}")).json()
    assert (problem["code"], problem["detail"][:15]) == ("storage.corrupt", f"calibration {calibration.id}: ")


async def test_several_parts_are_all_named(bench, monkeypatch):
    state = bench.storage.state()
    monkeypatch.setattr(bench.storage, "state", lambda: replace(state, free_bytes=1000))
    change(bench, is_following=lambda: False)
    problem = await unready(bench)
    assert problem["code"] == "service.not_ready"
    assert [error["code"] for error in problem["errors"]] == ["disk.full", "consumers.stopped"]


async def test_a_disk_that_cannot_be_written_has_its_code(bench, monkeypatch):
    state = bench.storage.state()
    monkeypatch.setattr(bench.storage, "state", lambda: replace(state, is_writable=False))
    assert (await unready(bench))["code"] == "disk.read_only"


async def test_metrics_tell_the_archive_and_the_interface(bench, make, monkeypatch):
    (row,) = bench.append([make.now_us - 90 * make.s], source="sa-1")
    bench.consume([Outcome((make.row(row),), make.command(row))])
    report = LinkReport("link-1", "analyzer", make.sc, "sa-1", "MEASURING", {}, {}, make.now_us - 5 * make.s)
    bench.storage.links.report([report], make.now_us)
    states = [
        CarrierState(f"c{k:02d}", -42.0, -42.0, 0.0, 0.0, 0.1, 0, word)
        for k, word in enumerate(["used", "absent", "excluded"])
    ]
    monkeypatch.setattr(bench.context.supervisor, "carrier_states", lambda _: (row, tuple(states)))
    monkeypatch.setattr(bench.context.supervisor, "rows_by_kind", lambda _: {True: 97, False: 3})
    body = {"plan_id": 1, "source": "sa-1", "measurements": [{"epoch": "2026-11-21T04:00:00Z", "power_dbm": [-42] * 6}]}
    assert (await bench.client.post(f"{bench.url}/measurements:batch", json=body)).json()["refused"]
    await bench.client.get("/api/v1/nothing/here")
    answer = await bench.client.get("/metrics", headers={"Authorization": ""})
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    reported, sc = samples(answer.text), make.sc
    assert reported["soo_sample_age_seconds", sc, "sa-1"] == 90.0
    assert [reported["soo_series_status", sc, f"c{k:02d}"] for k in range(3)] == [1.0, 0.0, 2.0]
    assert [reported["soo_filter_rows_total", sc, kind] for kind in ("ordinary", "event")] == [97.0, 3.0]
    assert reported["soo_attitude_deg", sc, "paper", "roll"] == -0.02
    assert reported["soo_attitude_sigma_deg", sc, "paper", "pitch"] == 0.02
    assert reported["soo_attitude_status", sc, "paper"] == 1.0
    assert reported["soo_control_allowed", sc] == 0.0, "the row may be used, and the interlock has seen none"
    assert reported["soo_rows_refused_total", sc, "time.future"] == 1.0
    assert reported["soo_link_state", "link-1", "MEASURING"] == 1.0
    assert reported["soo_link_last_good_age_seconds", "link-1"] == 5.0
    assert reported["soo_journal_lag", sc] == 0.0
    route = "/api/v1/spacecraft/{spacecraft_id}/measurements:batch"
    assert reported["soo_http_requests_total", "POST", route, "200"] == 1.0
    assert reported["soo_http_requests_total", "GET", "unmatched", "404"] == 1.0
    assert reported["soo_http_request_duration_seconds_count", route] == 1.0
    assert reported["soo_http_request_duration_seconds_bucket", route, "+Inf"] == 1.0
    assert reported["soo_ready", "database"] == 1.0
    assert reported["soo_process_resident_memory_bytes",] > 10e6


async def test_an_angle_that_is_not_known_is_left_out(bench, make):
    (row,) = bench.append([make.now_us])
    bench.consume([Outcome((make.row(row, attitude_deg=Axes(make.nan, 0.1, make.nan)),), None)])
    reported = samples((await bench.client.get("/metrics")).text)
    assert ("soo_attitude_deg", make.sc, "paper", "yaw") not in reported
    assert reported["soo_attitude_deg", make.sc, "paper", "roll"] == 0.1


async def test_metrics_without_the_database_tell_the_rest(bench, monkeypatch):
    def fail() -> None:
        raise StorageError("storage.unavailable", "gone")

    monkeypatch.setattr(bench.storage, "state", fail)
    answer = await bench.client.get("/metrics")
    assert answer.status_code == 200
    reported = samples(answer.text)
    assert reported["soo_ready", "database"] == 0.0
    assert ("soo_writer_queue",) not in reported
    assert ("soo_process_threads",) in reported


async def test_metrics_may_need_a_key(bench):
    change(bench, monitoring=replace(bench.context.monitoring, metrics_need_key=True))
    assert (await bench.client.get("/metrics", headers={"Authorization": ""})).status_code == 401
    assert (await bench.client.get("/metrics")).status_code == 200


async def test_label_sets_do_not_grow_with_what_is_asked(bench, make):
    for k in range(40):
        await bench.client.get(f"/api/v1/spacecraft/craft-{k}/status")
        await bench.client.get(f"/made-up-{k}")
        await bench.client.request(f"VERB{k}", "/healthz")
    reported = samples((await bench.client.get("/metrics")).text)
    routes = {key[2] for key in reported if key[0] == "soo_http_requests_total"}
    assert len(routes) <= 4, routes
    assert {key[1] for key in reported if key[0] == "soo_http_requests_total"} <= {"GET", "other"}
    names = {re.sub(r"_(total|bucket|count|sum)$", "", key[0]) for key in reported}
    assert names <= {re.sub(r"_total$", "", name) for name in FAMILIES}


async def test_every_request_has_a_line_with_its_id_and_template(bench, make, caplog):
    with caplog.at_level(logging.INFO, "soo.access"):
        path = f"/api/v1/spacecraft/{make.sc}/status"
        await bench.client.get(path, params={"key": "swordfish"}, headers={"X-Request-ID": "r-77"})
        await bench.client.get("/api/v1/spacecraft", headers={"Authorization": "Bearer swordfish"})
    lines = [record.fields for record in caplog.records if record.name == "soo.access"]
    assert [(line["method"], line["route"], line["status"]) for line in lines] == [
        ("GET", "/api/v1/spacecraft/{spacecraft_id}/status", 422),
        ("GET", "/api/v1/spacecraft", 401),
    ]
    assert lines[0]["key"] == "bootstrap"
    assert lines[1]["key"] is None
    assert lines[0]["duration_ms"] > 0
    assert "swordfish" not in json.dumps(lines)
    assert "swordfish" not in caplog.text


async def test_lines_written_while_a_request_is_served_name_it(bench, monkeypatch):
    written = []
    handler = logging.Handler()
    handler.setFormatter(JsonLogFormatter())
    handler.emit = lambda record: written.append(json.loads(handler.format(record)))

    def fail() -> None:
        raise RuntimeError("the password is swordfish")

    monkeypatch.setattr(bench.storage, "state", fail)
    root = logging.getLogger()
    root.addHandler(handler)
    try:
        answer = await bench.client.get("/readyz", headers={"X-Request-ID": "r-78"})
    finally:
        root.removeHandler(handler)
    assert answer.json()["request_id"] == "r-78"
    failed = next(line for line in written if line["level"] == "error")
    assert failed["request_id"] == "r-78"
    assert "RuntimeError" in failed["traceback"]
