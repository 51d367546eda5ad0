"""Every storage keeps the newest report of a link, and what operators want of it, beyond a restart."""

from dataclasses import replace

import pytest

from db.storage import SqlStorage
from service.errors import ConflictError, NotFoundError
from service.records.operations.link import LinkReport, LinkWarning

S = 1_000_000
REPORT = LinkReport(
    id="sa-1",
    kind="analyzer",
    spacecraft_id="craft",
    source="sa-1",
    state="MEASURE",
    detail={"identity": "R&S, FSV\u0000", "nested": [1, None, {"x": 0.5}]},
    counters={"sweeps": 1 << 52},
    last_good_us=7,
    warnings=(LinkWarning("spool.full", "half\nfull", 3),),
    reset_seen=1,
)


def test_a_report_comes_back_as_it_was_and_a_new_link_is_enabled(storage):
    (reported,) = storage.links.report([REPORT], 10 * S)
    assert (reported.report, reported.reported_at_us, reported.enabled, reported.resets) == (REPORT, 10 * S, True, 0)
    assert storage.links.link("sa-1") == reported
    assert storage.links.links() == (reported,)


def test_the_newest_report_holds_and_leaves_what_is_wanted_alone(storage):
    storage.links.report([REPORT], 10 * S)
    storage.links.set_enabled("sa-1", enabled=False)
    storage.links.request_reset("sa-1")
    assert storage.links.request_reset("sa-1").resets == 2
    changed = replace(REPORT, state="BACKOFF", reset_seen=2)
    (reported,) = storage.links.report([changed], 20 * S)
    assert (reported.report.state, reported.enabled, reported.resets) == ("BACKOFF", False, 2)
    assert storage.links.set_enabled("sa-1", enabled=True).enabled


def test_what_is_wanted_outlives_the_service(url):
    first = SqlStorage(url)
    first.prepare()
    first.links.report([REPORT], 10 * S)
    first.links.set_enabled("sa-1", enabled=False)
    first.links.request_reset("sa-1")
    first.close()
    second = SqlStorage(url)
    stored = second.links.link("sa-1")
    assert (stored.enabled, stored.resets, stored.report) == (False, 1, REPORT)
    second.close()


def test_links_are_listed_in_order_and_by_spacecraft(storage):
    others = [replace(REPORT, id=name, spacecraft_id=record) for name, record in (("z", "b"), ("a", None), ("m", "b"))]
    storage.links.report(others, S)
    assert [state.report.id for state in storage.links.links()] == ["a", "m", "z"]
    assert [state.report.id for state in storage.links.links("b")] == ["m", "z"]
    assert storage.links.links("c") == ()


def test_the_period_is_learned_and_one_outage_does_not_undo_it(storage):
    for k in range(20):
        (reported,) = storage.links.report([REPORT], (100 + 10 * k) * S)
    assert reported.period_s == pytest.approx(10.0)
    assert not reported.is_silent((290 + 30) * S)
    assert reported.is_silent((290 + 31) * S)
    (after,) = storage.links.report([REPORT], 10_000 * S)
    assert after.period_s == pytest.approx(15.0)
    # a stated one needs no learning
    (stated,) = storage.links.report([replace(REPORT, period_s=300.0)], 10_010 * S)
    assert stated.period_s == 300.0


def test_a_clock_that_went_back_teaches_no_negative_period(storage):
    storage.links.report([REPORT], 100 * S)
    assert storage.links.report([REPORT], 50 * S)[0].period_s >= 1.0


def test_an_unknown_link_is_told_so(storage):
    for call in (
        lambda: storage.links.link("x"),
        lambda: storage.links.set_enabled("x", enabled=True),
        lambda: storage.links.request_reset("x"),
        lambda: storage.links.remove("x"),
    ):
        with pytest.raises(NotFoundError) as caught:
            call()
        assert caught.value.code == "link.unknown"


def test_a_removed_link_comes_back_new(storage):
    storage.links.report([REPORT], S)
    storage.links.set_enabled("sa-1", enabled=False)
    storage.links.remove("sa-1")
    assert storage.links.links() == ()
    assert storage.links.report([REPORT], S)[0].enabled


def test_invented_ids_come_to_an_end_and_known_links_go_on(storage):
    storage.links.report([replace(REPORT, id=f"l{k}") for k in range(1000)], S)
    with pytest.raises(ConflictError) as caught:
        storage.links.report([replace(REPORT, id="l0", state="BACKOFF"), replace(REPORT, id="new")], 2 * S)
    assert caught.value.code == "link.too_many"
    # one report is one transaction
    assert storage.links.link("l0").report.state == "MEASURE"
    assert storage.links.report([replace(REPORT, id="l0", state="BACKOFF")], 2 * S)[0].report.state == "BACKOFF"
