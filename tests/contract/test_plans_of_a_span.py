"""Which carrier plans the rows of a window were stored under."""

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
