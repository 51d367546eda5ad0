"""The present of a spacecraft: by how many statements it is told, and that it is the truth wherever it is asked for."""

import contextlib
import threading
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest
from sqlalchemy import event
from sqlalchemy.engine import Engine

from service.api.context import ApiContext, Limits, PresentMemory
from service.api.routes.control import get_attitude
from service.api.views.present import status_of
from service.pipeline.config import InterlockConfig, TorqueConfig
from service.pipeline.control.release.interlock_conditions import ReleaseSettings
from service.records.catalogue import ControlSettings, Method
from service.records.inputs import Correction
from service.records.levels.attitude import Axes
from service.records.operations.work import LinkReport
from service.runtime.control.release_context import ReleasePublisher
from service.runtime.control.release_service import ReleaseService
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.supervisor import Supervisor


@contextlib.contextmanager
def statements() -> Iterator[list[str]]:
    """Note every SELECT of this thread: that of the supervisor goes on beside it."""
    selects: list[str] = []
    asking = threading.get_ident()

    def note(_connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
        if threading.get_ident() == asking and statement.lstrip().upper().startswith("SELECT"):
            selects.append(statement)

    event.listen(Engine, "before_cursor_execute", note)
    try:
        yield selects
    finally:
        event.remove(Engine, "before_cursor_execute", note)


def context_of(ground: Any, supervisor: Any, *, leads: bool) -> ApiContext:
    """Return what routes are handed by a process that leads the spacecraft, or by another one."""
    publisher = ReleasePublisher(ground.storage.audit, LiveFeed(), lambda _: None)
    release = ReleaseService(
        ground.storage, ground.clock, ReleaseSettings(), TorqueConfig(), publisher, turn=lambda _: int(leads)
    )
    parts = {
        "storage": ground.storage,
        "clock": ground.clock,
        "supervisor": supervisor,
        "release_service": release,
        "interlock": InterlockConfig(),
        "limits": Limits(),
        "memory": PresentMemory(),
    }
    return cast("ApiContext", SimpleNamespace(**parts))


@pytest.fixture
def ground(ground: Any) -> Any:
    """A station that the method drives which is calibrated."""
    spacecraft = ground.storage.catalogue.spacecraft(ground.id)
    ground.storage.catalogue.replace_spacecraft(replace(spacecraft, control=ControlSettings(Method.PAPER)))
    return ground


@pytest.fixture
def elsewhere(ground: Any) -> ApiContext:
    """Context of a process that runs no chain and has read nothing yet."""
    return context_of(ground, Supervisor(ground.storage, LiveFeed(), ground.config, turn=lambda _: 0), leads=False)


def told(context: ApiContext, spacecraft_id: str) -> tuple[str, str]:
    """Return status and attitude, without the interlock, which only the leading process moves."""
    status = status_of(context, spacecraft_id).model_dump_json(exclude={"control", "interlock"})
    return status, get_attitude(spacecraft_id, context).model_dump_json(exclude={"control"})


def test_the_leading_process_tells_status_and_attitude_by_one_statement_each(ground: Any, wait: Any) -> None:
    with ground.supervised() as supervisor:
        context = context_of(ground, supervisor, leads=True)
        ground.append(range(1, 31))
        ground.settle(supervisor)
        told(context, ground.id)
        for minute in (31, 32):
            ground.append([minute])
            ground.settle(supervisor)
            with statements() as selects:
                status = status_of(context, ground.id)
            assert len(selects) == 1, "\n".join(each[each.find("FROM") :] for each in selects)
            assert (status.pending, status.newest_attitude) == (0, status.newest_measurement)
            with statements() as selects:
                get_attitude(ground.id, context)
            assert len(selects) == 1, selects


def test_another_process_reads_after_a_row_and_asks_one_question_until_the_next(ground: Any, elsewhere: Any) -> None:
    with ground.supervised() as supervisor:
        ground.append(range(1, 31))
        ground.settle(supervisor)
        first = told(elsewhere, ground.id)
        with statements() as selects:
            again = told(elsewhere, ground.id)
        assert again == first
        # two answers, and what the leading process has stored of its interlock
        assert len([each for each in selects if "FROM release" not in each and "spacecraft.document" not in each]) == 2


def test_every_process_tells_the_same(ground: Any) -> None:
    links = ground.storage.links
    paused = LinkReport("rx", "run", ground.id, "sa-1", "PAUSED", {}, {}, None)
    correction = Correction(ground.at(38), ground.at(39), Axes(0.0, 0.01, 0.0))
    with ground.supervised() as supervisor:
        leading = context_of(ground, supervisor, leads=True)
        other = context_of(ground, Supervisor(ground.storage, LiveFeed(), ground.config, turn=lambda _: 0), leads=False)
        steps = (
            lambda: ground.append(range(1, 31)),
            lambda: ground.append([32]),
            lambda: ground.append([31]),
            lambda: links.report([paused], ground.clock.system_us()),
            lambda: links.set_enabled("rx", enabled=False),
            lambda: ground.storage.archive.append_inputs(ground.id, [correction]),
            lambda: ground.append(range(33, 45)),
            ground.align,
            lambda: ground.append([45]),
        )
        for step in steps:
            step()
            ground.settle(supervisor)
            fresh = context_of(ground, other.supervisor, leads=False)
            assert told(leading, ground.id) == told(fresh, ground.id) == told(other, ground.id)
    with ground.supervised() as supervisor:
        leading = context_of(ground, supervisor, leads=True)
        for step in (lambda: None, lambda: ground.append([46])):
            step()
            ground.settle(supervisor)
            assert told(leading, ground.id) == told(other, ground.id), "after a restart"


def test_nothing_is_pending_only_where_the_newest_row_is_told(ground: Any, elsewhere: Any, monkeypatch: Any) -> None:
    """Rows get their results between the statement that tells the head and the one that counts."""
    results = type(ground.storage.results)
    count = results.pending
    with ground.supervised() as supervisor:
        ground.append(range(1, 31))
        ground.settle(supervisor)

    def late(self: Any, spacecraft_id: str, methods: Any) -> int:
        with ground.supervised() as supervisor:
            ground.settle(supervisor)
        return int(count(self, spacecraft_id, methods))

    ground.append([31])
    monkeypatch.setattr(results, "pending", late)
    status = status_of(elsewhere, ground.id)
    assert status.pending > 0 or status.newest_attitude == status.newest_measurement
    after = status_of(elsewhere, ground.id)
    assert (after.pending, after.newest_attitude) == (0, after.newest_measurement)
