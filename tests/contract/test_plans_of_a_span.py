"""Rows of a window: the carrier plans that they were stored under, and the last of their journal numbers."""

from service.records.calibration import Window


def test_plans_of_a_window(setting, make):
    assert setting.storage.archive.plan_ids(setting.id, make.ever) == ()
    setting.append([10, 20])
    second = setting.storage.catalogue.put_plan(setting.id, make.carriers[::-1], "other")
    setting.plan_id = second.id
    setting.append([30])
    archive = setting.storage.archive
    assert archive.plan_ids(setting.id, make.ever) == (1, 2)
    assert archive.plan_ids(setting.id, Window(10, 30)) == (1,), "stop is exclusive"
    assert archive.plan_ids(setting.id, Window(30, 31)) == (2,), "start is inclusive"
    assert archive.plan_ids(setting.id, Window(21, 30)) == ()


def test_behind_the_last_number_of_a_window_no_row_lies_in_it(setting):
    day_us = 86_400_000_000
    setting.append([10, 20, day_us + 10])
    setting.append([15], source="sa-2")
    setting.append([2 * day_us + 10])
    windows = [Window(0, 16), Window(16, 30), Window(day_us, 2 * day_us), Window(0, 1 << 50), Window(30, 40)]
    rows = setting.rows()
    newest = [max((row.number for row in rows if w.start_us <= row.epoch_us < w.stop_us), default=0) for w in windows]
    assert [setting.storage.archive.last_number(setting.id, window) for window in windows] == newest
    # of a sealed day more than the last row may be told, never less
    assert list(setting.storage.archive.seal(setting.id, 2 * day_us, 2**60))
    told = [setting.storage.archive.last_number(setting.id, window) for window in windows]
    assert all(one >= least for one, least in zip(told, newest, strict=True))
    assert told[2:4] == newest[2:4]
