"""Every storage keeps a ring of evidence traces a source: once each, bit for bit, the oldest epoch goes first."""

import numpy as np
import pytest

from service.errors import ConflictError, NotFoundError
from service.records.calibration import Window
from service.records.levels.trace import Ring, Trace, TraceReceipt, TraceSettings

SETTINGS = TraceSettings(954e6, 15e3, 30e3, 31.5e3, 0.0)
WIDE = Ring(1000, 1 << 30)
EVER = Window(0, 1 << 60)


def trace(epoch_us: int, sweep: str = "tp1", points: int = 7) -> Trace:
    power_dbm = np.random.default_rng(epoch_us).normal(-90.0, 3.0, points).astype(np.float32).astype(np.float64)
    power_dbm[0] = np.nan
    return Trace(epoch_us, sweep, SETTINGS, power_dbm)


def epochs_of(setting, **options) -> list[int]:
    heads = setting.storage.traces.heads(setting.id, EVER, 10_000, None, **options)
    return [head.epoch_us for head in heads]


def append(setting, traces, ring: Ring = WIDE, source: str = "sa-1") -> TraceReceipt:
    return setting.storage.traces.append(setting.id, source, traces, 77, ring)


@pytest.mark.parametrize("points", [1, 2, 2401])
def test_a_trace_comes_back_bit_for_bit(setting, points):
    sent = trace(10, points=points)
    assert append(setting, [sent]) == TraceReceipt(1, 0, 0)
    kept = setting.storage.traces.trace(setting.id, 10)
    # float32 values: no tolerance
    np.testing.assert_array_equal(kept.power_dbm, sent.power_dbm)
    head = kept.head
    assert (head.source, head.sweep, head.settings, head.points, head.received_at_us) == (
        "sa-1",
        "tp1",
        SETTINGS,
        points,
        77,
    )
    with pytest.raises(ValueError, match="read-only"):
        kept.power_dbm[0] = 0


def test_source_sweep_and_epoch_are_the_key_and_the_first_one_stays(setting):
    first, again = trace(10), Trace(10, "tp1", SETTINGS, np.zeros(3))
    assert append(setting, [first, again]) == TraceReceipt(1, 1, 0)
    assert append(setting, [again, trace(10, "tp2"), trace(11)]) == TraceReceipt(2, 1, 0)
    assert append(setting, [trace(10)], source="sa-2") == TraceReceipt(1, 0, 0)
    assert setting.storage.traces.trace(setting.id, 10, "sa-1", "tp1").head.points == 7
    with pytest.raises(ConflictError) as caught:
        setting.storage.traces.trace(setting.id, 10, "sa-1")
    assert caught.value.code == "trace.ambiguous"


def test_unknown_traces_and_spacecraft_are_told(setting):
    append(setting, [trace(10)])
    for options in ({"epoch_us": 11}, {"epoch_us": 10, "source": "sa-2"}, {"epoch_us": 10, "sweep": "tp2"}):
        with pytest.raises(NotFoundError) as caught:
            setting.storage.traces.trace(setting.id, **options)
        assert caught.value.code == "trace.unknown"
    with pytest.raises(NotFoundError) as record:
        setting.storage.traces.append("nobody", "sa-1", [trace(1)], 1, WIDE)
    assert record.value.code == "spacecraft.unknown"


def test_the_ring_keeps_the_newest_epochs_of_each_source(setting):
    small = Ring(3, 1 << 30)
    assert append(setting, [trace(k) for k in (10, 20, 30)], small).dropped == 0
    assert append(setting, [trace(k) for k in (40, 50)], small) == TraceReceipt(2, 0, 2)
    # sent late: older than all that is kept, so it goes at once
    assert append(setting, [trace(5)], small) == TraceReceipt(1, 0, 1)
    assert append(setting, [trace(1)], small, source="sa-2") == TraceReceipt(1, 0, 0)
    assert epochs_of(setting) == [1, 30, 40, 50]


def test_the_ring_is_bounded_by_bytes_too(setting):
    append(setting, [trace(k, points=500) for k in range(1, 9)])
    (size,) = {head.size_bytes for head in setting.storage.traces.heads(setting.id, EVER, 1, None)}
    kept = append(setting, [trace(9, points=500)], Ring(1000, 4 * size))
    assert kept.accepted == 1
    heads = setting.storage.traces.heads(setting.id, EVER, 100, None)
    assert sum(head.size_bytes for head in heads) <= 4 * size
    assert [head.epoch_us for head in heads][-1] == 9
    assert len(heads) >= 3


def test_a_ring_of_nothing_keeps_nothing(setting):
    append(setting, [trace(k) for k in range(1, 700)])
    assert append(setting, [trace(800)], Ring(0, 1 << 30)) == TraceReceipt(1, 0, 700)
    assert epochs_of(setting) == []


def test_pages_of_heads_join_and_filters_choose(setting):
    append(setting, [trace(10), trace(20), trace(20, "tp2"), trace(30)])
    append(setting, [trace(20)], source="sa-2")
    traces, after, pages = setting.storage.traces, None, []
    while page := traces.heads(setting.id, Window(10, 30), 2, after):
        pages.append([(head.epoch_us, head.number) for head in page])
        after = pages[-1][-1]
    assert [epoch_us for page in pages for epoch_us, _ in page] == [10, 20, 20, 20]
    assert len({number for page in pages for _, number in page}) == 4
    assert epochs_of(setting, source="sa-2") == [20]
    assert epochs_of(setting, sweep="tp2") == [20]
    assert epochs_of(setting, source="sa-2", sweep="tp2") == []
