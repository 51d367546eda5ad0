"""Heads of journals that were logged tell what an archive has lost, on every storage."""

import shutil

import numpy as np
import pytest

from db.maintenance.doctor import diagnose
from service.records.inputs import Operation
from service.records.journal import JournalHead
from service.records.levels.measurement import CarrierDetails
from service.runtime.clock import system_now_us

DAY_US = 86_400_000_000


def compared(url, heads):
    """Return what the doctor says of heads."""
    found = diagnose(url, system_now_us(), lambda _: None, heads)
    return [(each.state, each.detail) for each in found if each.check == "log"]


def head(setting):
    (found,) = [each for each in setting.storage.archive.journal_heads() if each.spacecraft_id == setting.id]
    return found


def test_heads_of_every_kind_of_entry_hold_also_when_their_day_is_sealed(setting, url):
    heads = [head(setting)]
    details = CarrierDetails(*np.array([[[0.5, np.nan, 1.0]]] * 4, dtype=np.float32))
    for step in (
        lambda: setting.append([10], float("nan")),
        lambda: setting.append([20], -0.0, flags=[(1, 2, 3)], first_seq=5),
        lambda: setting.append([30], details=details),
        lambda: setting.append([25], source="sa-2", flags=[(0, 0, 0)], is_stale=[True]),
        lambda: setting.storage.archive.add_operation(setting.id, Operation(0, "eclipse", 1, 2, comment="тень")),
    ):
        step()
        heads.append(head(setting))
    assert [each.number for each in heads] == list(range(heads[0].number, heads[0].number + 6))
    assert len({each.digest for each in heads}) == 6
    said = [("ok", f"{setting.id}: 6 entries are those that the log names, up to {heads[-1].number}")]
    assert compared(url, heads) == said
    assert sum(part.rows for part in setting.storage.archive.seal(setting.id, 2 * DAY_US, system_now_us())) == 4
    assert compared(url, heads) == said
    setting.consume()
    assert sum(each.rows for each in setting.storage.archive.drop_before(setting.id, "measurements", DAY_US)) == 4
    assert [state for state, _ in compared(url, heads)] == ["ok"]
    assert compared(url, []) == []


@pytest.mark.parametrize("change", [{"digest": "0" * 16}, {"number": 3}])
def test_an_entry_that_is_another_one_is_told(setting, url, change):
    setting.append([10])
    ((state, words),) = compared(url, [head(setting), head(setting)._replace(**change)])
    assert (state, "are not those that the log names" in words) == ("fault", True)


def test_a_spacecraft_that_is_gone_is_told(setting, url):
    ((state, words),) = compared(url, [JournalHead("nobody", 7, "0" * 16)])
    assert (state, words) == ("fault", "nobody: 7 entries are lost: the log names 7, the journal ends at 0")


def test_rows_of_a_deleted_write_ahead_log_are_told_and_nothing_else_tells_them(setting, url, tmp_path):
    if not url.startswith("sqlite"):
        pytest.skip("about files")
    setting.append(range(1, 11))
    engine = setting.storage._database.engines.write
    with engine.connect() as connection:
        connection.exec_driver_sql("ROLLBACK")
        connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
        connection.exec_driver_sql("BEGIN")
    before = head(setting)
    setting.append(range(11, 1011))
    after = head(setting)
    # what a kill leaves, and then the log is deleted
    (tmp_path / "killed").mkdir()
    killed = tmp_path / "killed" / "soo.db"
    shutil.copy(tmp_path / "soo.db", killed)
    lost = f"sqlite:///{killed}"
    assert {each.state for each in diagnose(lost, system_now_us(), lambda _: None) if each.check != "disk"} == {"ok"}
    ((state, words),) = compared(lost, [before, after])
    assert (state, words.split(": ")[1]) == ("fault", "1000 entries are lost")
    assert [state for state, _ in compared(lost, [before])] == ["ok"]
