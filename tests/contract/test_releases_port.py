"""Every storage keeps state, commands and uplink products of the release; of two who change it only one succeeds."""

import math
import threading
from dataclasses import replace

import pytest

from db.storage import SqlStorage
from service.errors import ConflictError, NotFoundError
from service.records.calibration import Window
from service.records.levels.attitude import Axes
from service.records.levels.command import Pulse, ReleasedCommand, ReportedCommand
from service.records.operations.release import (
    Command,
    CommandCheck,
    CommandState,
    InterlockHold,
    ProductForm,
    Purpose,
    ReleaseChange,
    StoredRelease,
    UplinkProduct,
)

S = 1_000_000
AXES = Axes(0.001, -0.0, math.nan)
PULSES = (Pulse(900 * S, 2.5, Axes(0.0, 0.002, 0.0)), Pulse(990 * S, 2.5, Axes(0.0, -0.002, 0.0)))
COMMAND = Command(
    counter=1,
    state=CommandState.PREPARED,
    digest="ab",
    purpose=Purpose.CONTROL,
    is_automatic=False,
    is_simulated=True,
    reason="station \u0000 \u20ac",
    prepared_by="ann",
    prepared_us=700 * S,
    expires_us=900 * S,
    attitude_epoch_us=690 * S,
    start_us=900 * S,
    stop_us=993 * S,
    schedule=PULSES,
    impulse_n_m_s=AXES,
    gross_impulse_n_m_s=AXES,
    angle_change_deg=AXES,
    rate_change_deg_s=AXES,
    peak_angle_deg=AXES,
    peak_rate_deg_s=AXES,
    wheel_momentum_n_m_s=(0.1, -0.2),
    checks=(CommandCheck("envelope", True, ""),),
)
PRODUCT = UplinkProduct(ProductForm.TORQUES, 1, 800 * S, 900 * S, 993 * S, 690 * S, True, "ab", PULSES)
ANGLES = UplinkProduct(ProductForm.ATTITUDE, 1, 5 * S, 5 * S, 8 * S, 4 * S, True, attitude_deg=AXES, sigma_deg=AXES)


def change(document="{}", **parts):
    return ReleaseChange(document, "process-1", **parts)


def test_the_state_comes_back_as_it_was_with_its_version(setting):
    releases = setting.storage.releases
    assert releases.stored(setting.id) == StoredRelease()
    assert releases.save(setting.id, 0, change('{"a": 1}')) == 1
    assert releases.save(setting.id, 1, replace(change('{"a": 2}'), holder="process-2")) == 2
    assert releases.stored(setting.id) == StoredRelease(2, '{"a": 2}', "process-2")
    with pytest.raises(NotFoundError, match=r"spacecraft\.unknown"):
        releases.stored("nobody")


@pytest.mark.parametrize("version", [0, 2, -1])
def test_who_does_not_know_the_newest_version_changes_nothing(setting, version):
    releases = setting.storage.releases
    releases.save(setting.id, 0, change("first"))
    number = setting.storage.archive.head(setting.id).newest_number
    reported = (InterlockHold(1, "TRIPPED", ("stop",), is_withheld=True, version=9),)
    with pytest.raises(ConflictError, match=r"release\.changed"):
        releases.save(setting.id, version, change("second", commands=(COMMAND,), products=(PRODUCT,), entries=reported))
    assert releases.stored(setting.id).document == "first"
    assert releases.newest_product(setting.id, ProductForm.TORQUES) is None
    assert setting.storage.archive.head(setting.id).newest_number == number
    with pytest.raises(NotFoundError, match=r"command\.unknown"):
        releases.command(setting.id, 1)


def test_of_many_that_change_it_at_once_one_succeeds(setting, url):
    second = SqlStorage(url)
    barrier, won, lost = threading.Barrier(6), [], []

    def attempt(storage, name):
        barrier.wait()
        try:
            won.append(storage.releases.save(setting.id, 0, replace(change(), holder=name)))
        except ConflictError:
            lost.append(name)

    threads = [threading.Thread(target=attempt, args=((setting.storage, second)[k % 2], str(k))) for k in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    second.close()
    assert (won, len(lost)) == ([1], 5)


def test_a_command_changes_its_state_and_never_what_it_is(setting):
    releases = setting.storage.releases
    releases.save(setting.id, 0, change(commands=(COMMAND,)))
    assert repr(releases.command(setting.id, 1)) == repr(COMMAND)
    released = replace(COMMAND, state=CommandState.RELEASED, confirmed_by="bob", released_us=800 * S)
    releases.save(setting.id, 1, change(commands=(released,), products=(PRODUCT,)))
    assert repr(releases.command(setting.id, 1)) == repr(released)
    with pytest.raises(ConflictError, match=r"release\.changed"):
        releases.save(setting.id, 2, change(commands=(replace(released, digest="other"),)))
    assert releases.stored(setting.id).version == 2


def test_uplink_products_are_only_added(setting):
    releases = setting.storage.releases
    releases.save(setting.id, 0, change(products=(PRODUCT, ANGLES, replace(ANGLES, counter=2))))
    assert releases.product(setting.id, ProductForm.TORQUES, 1) == PRODUCT
    assert repr(releases.newest_product(setting.id, ProductForm.ATTITUDE)) == repr(replace(ANGLES, counter=2))
    with pytest.raises(ConflictError, match=r"release\.changed"):
        releases.save(setting.id, 1, change(products=(replace(PRODUCT, digest="other"),)))
    assert releases.product(setting.id, ProductForm.TORQUES, 1) == PRODUCT
    with pytest.raises(NotFoundError, match=r"uplink\.unknown"):
        releases.product(setting.id, ProductForm.TORQUES, 2)


def test_commands_are_listed_in_order_of_preparation_beyond_a_cursor(setting, new_setting):
    releases = setting.storage.releases
    made = tuple(replace(COMMAND, counter=k, prepared_us=(700 + k // 2) * S) for k in range(1, 6))
    releases.save(setting.id, 0, change(commands=made))
    releases.save(new_setting().id, 0, change(commands=(COMMAND,)))
    window = Window(700 * S, 702 * S)
    first = releases.commands(setting.id, window, 2, None)
    assert [command.counter for command in first] == [1, 2]
    rest = releases.commands(setting.id, window, 9, (first[-1].prepared_us, 2))
    assert [command.counter for command in rest] == [3]


def test_release_and_report_enter_the_journal_with_the_state(setting):
    releases, archive = setting.storage.releases, setting.storage.archive
    before = archive.head(setting.id).newest_number
    reported = (
        ReleasedCommand(1, 800 * S, PULSES),
        ReportedCommand(1, 1000 * S, PULSES[:1]),
        InterlockHold(1000 * S, "TRIPPED", ("stop",), is_withheld=True, version=1),
    )
    releases.save(setting.id, 0, change(entries=reported))
    assert tuple(entry.content for entry in archive.journal(setting.id, before, 9)) == reported
    again = InterlockHold(1000 * S, "INHIBITED", (), is_withheld=False, version=2)
    releases.save(setting.id, 1, change(entries=(again,)))
    holds = archive.inputs(setting.id, "interlock", Window(0, 1 << 60), 9, None)
    assert [entry.content.version for entry in holds] == [1, 2]
    # a version that is told again would be lost without a word
    with pytest.raises(ConflictError, match=r"release\.changed"):
        releases.save(setting.id, 2, change("third", entries=reported[:1]))
    assert releases.stored(setting.id).version == 2


def test_what_was_saved_is_there_after_the_database_was_closed(setting, url):
    setting.storage.releases.save(setting.id, 0, change("kept", commands=(COMMAND,), products=(PRODUCT,)))
    reopened = SqlStorage(url)
    assert reopened.releases.stored(setting.id).document == "kept"
    assert reopened.releases.product(setting.id, ProductForm.TORQUES, 1) == PRODUCT
    reopened.close()
