"""Every storage gives every list from its end too: pages from the end are those from the start turned round."""

import random

import numpy as np
import pytest

from db.encoding.segments import DAY_US
from service.ports import LIVE, Outcome
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.inputs import AttitudeReference, Operation
from service.records.levels.attitude import Axes
from service.records.levels.trace import Ring, Trace, TraceSettings
from service.records.operations.alarm import Alarm, AlarmChange, ChangeKind, Cover, Process, Severity
from service.records.operations.audit import AuditEvent, AuditFilter
from service.records.operations.job import Replay
from service.records.operations.note import Note
from service.records.operations.release import Command, CommandState, Purpose, ReleaseChange

DAYS = 3
STEP_US = DAY_US // 12
REPLAYED = "replay-1"
EVER = Window(0, DAYS * DAY_US + 1)
ALWAYS = 1 << 60


def by_epoch(row):
    return row.epoch_us, row.number


def joined(read, position, limit, *, newest_first):
    """Return all rows of a list page by page."""
    found, after = [], None
    while page := read(limit, after, newest_first=newest_first):
        assert len(page) <= limit
        found += page
        after = position(page[-1])
    return found


def fill(setting, make, random_of):
    """Store rows of two sources at shared epochs, of two versions, and some of everything that is listed."""
    storage, name = setting.storage, setting.id
    epochs_us = [k * STEP_US for k in range(DAYS * 12)]
    setting.append(epochs_us[: len(epochs_us) // 2])
    setting.append(random_of.sample(epochs_us, 20), source="sa-2")
    setting.append(epochs_us[len(epochs_us) // 2 :])
    rows = [row for row in setting.rows() if row.feeds_estimator]
    # of some measurements no method computed anything
    computed = [row for row in rows if random_of.random() < 0.8]
    outcomes = [Outcome((make.attitude_row(row),), make.torque_command(row)) for row in computed]
    setting.consume(outcomes)
    setting.consume(outcomes, REPLAYED)
    for k in range(8):
        at_us = random_of.choice(epochs_us)
        storage.notes.add(Note(0, name, at_us, at_us, "ann", f"note {k}", (), None))
        storage.alarms.save([AlarmChange(ChangeKind.RAISED, alarm(name, k, at_us), at_us, is_told=True)])
        storage.archive.add_operation(name, Operation(0, "slew", at_us, at_us + random_of.randrange(DAY_US)))
        target = f"/spacecraft/{name}/{k}"
        storage.audit.append(audit_event(target))
        replay = Replay(0, at_us, at_us + STEP_US, Method.PAPER, None, 3, "journal", f"{name}-{k}", 9)
        storage.results.add_replay(name, replay)
        storage.releases.save(name, k, ReleaseChange("{}", "process-1", commands=(command(k + 1, at_us),)))
    star = Axes(0.1, 0.2, 0.3)
    storage.archive.append_inputs(name, [AttitudeReference("star", at_us, star, star) for at_us in epochs_us])
    settings = TraceSettings(954e6, 15e3, 30e3, 31.5e3, 0.0)
    for source in ("sa-1", "sa-2"):
        traces = [Trace(at_us, "tp1", settings, np.zeros(3)) for at_us in random_of.sample(epochs_us, 8)]
        storage.traces.append(name, source, traces, 77, Ring(1000, 1 << 30))


def alarm(spacecraft_id, k, at_us):
    instance = (spacecraft_id, "carrier_absent", f"c{k}", Process.UNACKNOWLEDGED, Cover.NONE, Severity.WATCH)
    return Alarm(0, *instance, at_us, at_us, at_us, 1.0, 2.0, "s", "")


def audit_event(target):
    names = ("who", "key_id", "role", "address", "action", "outcome", "request_id")
    return AuditEvent(at_us=5, target=target, **dict.fromkeys(names, "a"))


def command(counter, at_us):
    axes = Axes(0.0, 0.0, 0.0)
    return Command(
        counter=counter,
        state=CommandState.PREPARED,
        digest="ab",
        purpose=Purpose.CONTROL,
        is_automatic=False,
        is_simulated=True,
        reason="",
        prepared_by="ann",
        prepared_us=at_us,
        expires_us=at_us + 1,
        attitude_epoch_us=at_us,
        start_us=at_us,
        stop_us=at_us,
        schedule=(),
        **dict.fromkeys(("impulse_n_m_s", "gross_impulse_n_m_s", "angle_change_deg", "rate_change_deg_s"), axes),
        **dict.fromkeys(("peak_angle_deg", "peak_rate_deg_s"), axes),
        wheel_momentum_n_m_s=(),
        checks=(),
    )


def lists_of(setting, window):
    """Return every list as a reader of pages and what its cursor holds."""
    storage, name = setting.storage, setting.id
    results, archive = storage.results, storage.archive
    wanted = AuditFilter(start_us=0, stop_us=ALWAYS, target_prefix=f"/spacecraft/{name}/")

    def of_inputs(kind):
        return (
            lambda limit, after, **order: archive.inputs(name, kind, window, limit, after, **order),
            lambda entry: (entry.start_us, entry.number),
        )

    def of_attitude(version, method):
        return (
            lambda limit, after, **order: results.attitude_rows(name, version, method, window, limit, after, **order),
            by_epoch,
        )

    return {
        "attitude": of_attitude(LIVE, Method.ROBUST),
        "attitude without rows": of_attitude(LIVE, Method.PAPER),
        "attitude of a replay": of_attitude(REPLAYED, Method.ROBUST),
        "torques": (lambda *page, **order: results.commands(name, LIVE, window, *page, **order), by_epoch),
        "replays": (
            lambda *page, **order: results.replays(name, window, *page, **order),
            lambda each: each.replay.id,
        ),
        "measurements": (lambda *page, **order: archive.measurements(name, window, *page, **order), by_epoch),
        "measurements of a source": (
            lambda *page, **order: archive.measurements(name, window, *page, "sa-2", **order),
            by_epoch,
        ),
        "references": of_inputs("reference"),
        "operations": of_inputs("operation"),
        "alarms": (
            lambda *page, **order: storage.alarms.alarms(name, [], window, *page, **order),
            lambda alarm: (alarm.raised_at_us, alarm.id),
        ),
        "notes": (
            lambda *page, **order: storage.notes.notes(window, *page, name, **order),
            lambda note: (note.epoch_us, note.id),
        ),
        "commands": (
            lambda *page, **order: storage.releases.commands(name, window, *page, **order),
            lambda command: (command.prepared_us, command.counter),
        ),
        "traces": (
            lambda *page, **order: storage.traces.heads(name, window, *page, **order),
            by_epoch,
        ),
        "audit": (
            lambda *page, **order: storage.audit.entries(wanted, *page, **order),
            lambda entry: entry.number,
        ),
    }


def check(setting, random_of):
    """Compare both orders of every list in some windows."""
    first, last = sorted(random_of.sample(range(DAYS * 24), 2))
    windows = [EVER, Window(STEP_US, STEP_US + 1), Window(first * STEP_US // 2, last * STEP_US // 2)]
    sizes = {}
    for window in windows:
        for what, (read, position) in lists_of(setting, window).items():
            expected = repr(joined(read, position, 10_000, newest_first=False)[::-1])
            for limit in (random_of.randrange(1, 9), 10_000):
                found = joined(read, position, limit, newest_first=True)
                assert repr(found) == expected, (what, window, limit)
                sizes[what] = max(sizes.get(what, 0), len(found))
    # none of the lists was compared while it was empty
    assert min(sizes.values()) > 5, sizes


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_pages_from_the_end_are_those_from_the_start_turned_round(setting, make, seed):
    print(f"seed {seed}")
    random_of = random.Random(seed)
    fill(setting, make, random_of)
    check(setting, random_of)
    # of the first day all is sealed, of the second the results alone, and rows arrive late into both
    list(setting.storage.archive.seal(setting.id, DAY_US, ALWAYS))
    list(setting.storage.results.seal(setting.id, 2 * DAY_US))
    setting.append([STEP_US + 5, DAY_US + 5], source="sa-3")
    check(setting, random_of)
    # of the first hours the attitude alone is left
    list(setting.storage.archive.drop_before(setting.id, "measurements", DAY_US))
    check(setting, random_of)


def test_a_page_from_the_end_reads_what_it_holds_and_no_more(setting, make):
    """A list that is long costs no more from its end than a short one."""
    setting.append(range(0, 3000 * 1_000_000, 1_000_000))
    seen = []
    archive = setting.storage.archive
    page = archive.measurements(setting.id, EVER, 10, None, newest_first=True)
    assert [row.epoch_us for row in page] == [k * 1_000_000 for k in range(2999, 2989, -1)]
    pages = archive._pages

    def counting(connection, key):
        found = pages(connection, key)
        read = found.read

        def counted(*arguments, **options):
            runs = read(*arguments, **options)
            seen.append(sum(len(run.positions) for run in runs))
            return runs

        found.read = counted
        return found

    archive._pages = counting
    archive.measurements(setting.id, EVER, 10, (page[-1].epoch_us, page[-1].number), newest_first=True)
    assert sum(seen) < 40
