"""A row that is later than a trip gets no torque, also where it was stored before the trip and computed after it."""

from contextlib import contextmanager

import pytest

from service.pipeline.config import TorqueConfig
from service.pipeline.control.release.events import OrderKind
from service.pipeline.control.release.settings import ReleaseSettings
from service.records.levels.command import AppliedCommand
from service.records.operations.release import InterlockHold
from service.runtime.control.release_publisher import ReleasePublisher
from service.runtime.control.release_service import ReleaseService
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.supervisor import Supervisor


class DataClock:
    """The clock of the data, by the archive's head."""

    def __init__(self, ground):
        self._ground = ground

    def now_us(self, spacecraft_id):
        return self._ground.storage.archive.head(spacecraft_id).newest_epoch_us

    def is_data(self, spacecraft_id):
        return True

    def system_us(self):
        return 1_900_000_000_000_000


class Watched:
    """A release service of which an operator stops control at a row, after it was computed and before it is stored."""

    def __init__(self, service, stop_after):
        self.service, self.stop_after, self.parts = service, stop_after, 0

    def on_rows(self, spacecraft_id, seen, *, has_inputs=False):
        self.service.on_rows(spacecraft_id, seen, has_inputs=has_inputs)
        self.parts += any(one.outcome.applied is not None for one in seen)

    @contextmanager
    def steady(self, spacecraft_id):
        if self.parts == self.stop_after:
            self.parts += 1
            self.service.order(spacecraft_id, OrderKind.STOP, "ann")
        with self.service.steady(spacecraft_id) as is_withheld:
            yield is_withheld


@contextmanager
def released(ground, stop_after, settings):
    publisher = ReleasePublisher(ground.storage.audit, LiveFeed(), lambda _: None)
    service = ReleaseService(ground.storage, DataClock(ground), settings, TorqueConfig(), publisher)
    supervisor = Supervisor(ground.storage, LiveFeed(), ground.config, release=Watched(service, stop_after))
    supervisor.start()
    try:
        yield supervisor, service
    finally:
        supervisor.stop()


@pytest.mark.parametrize(
    ("stop_after", "settings"),
    [
        pytest.param(3, ReleaseSettings(), id="an operator stops between computing and storing"),
        pytest.param(-1, ReleaseSettings(impulse_n_m_s=1e-4), id="a command of the batch itself trips"),
    ],
)
def test_rows_behind_a_trip_get_no_torque_live_and_in_a_replay(ground, stop_after, settings):
    ground.append(range(1, 41))
    with released(ground, stop_after, settings) as (supervisor, service):
        ground.settle(supervisor)
        assert service.control(ground.id).state == "TRIPPED"
        ground.append(range(41, 46))
        ground.settle(supervisor)
    entries = [entry.content for entry in ground.storage.archive.journal(ground.id, 0, 10_000)]
    (hold,) = [each for each in entries if isinstance(each, InterlockHold)]
    applied = [each.command.attitude_epoch_us for each in entries if isinstance(each, AppliedCommand)]
    assert len(applied) == (stop_after if stop_after > 0 else 1)
    assert max(applied) <= hold.at_us
    commands = ground.commands()
    later = [each for each in commands if each.attitude_epoch_us > hold.at_us]
    assert len(later) > 20
    for command in later:
        assert (command.control_allowed, command.schedule, "tripped" in command.inhibitions) == (False, (), True)
        assert command.torque_n_m == (0.0, 0.0, 0.0)
    version = ground.replay(1, 60)
    replayed = ground.commands(version)
    assert [repr(each) for each in replayed] == [repr(each) for each in commands]
    assert [repr(each) for each in ground.rows(version)] == [repr(each) for each in ground.rows()]


def test_a_service_killed_between_trip_and_rows_withholds_them_after_its_start(ground):
    publisher = ReleasePublisher(ground.storage.audit, LiveFeed(), lambda _: None)
    service = ReleaseService(ground.storage, DataClock(ground), ReleaseSettings(), TorqueConfig(), publisher)
    ground.append(range(1, 41))
    # stopped before any of them is computed: all are later than what anybody has seen
    service.order(ground.id, OrderKind.STOP, "ann")
    with released(ground, -1, ReleaseSettings()) as (supervisor, _):
        ground.settle(supervisor)
    assert not any(each.control_allowed for each in ground.commands())
    assert any("tripped" in each.inhibitions for each in ground.commands())
