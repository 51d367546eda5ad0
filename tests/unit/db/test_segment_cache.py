"""Sealed days kept unpacked: for everybody as many as fit, for one who reads more than fits only the last one."""

from typing import Any, cast

from db.encoding.segments import SegmentCache, SegmentChunk, SegmentHead

CARRIERS = 16
ROWS = 100


def head(number: int) -> SegmentHead:
    return SegmentHead(number, 1, 1, 1, number, ROWS, ROWS, 0, 1, 1, ROWS, 1, 7)


def chunk(number: int) -> SegmentChunk:
    return cast("SegmentChunk", ("piece", number))


def held(cache: SegmentCache) -> list[int]:
    return [number for number in range(1, 10) if cache.get(head(number)) is not None]


def filled(cache: Any, *numbers: int) -> Any:
    for number in numbers:
        cache.put(head(number), chunk(number), CARRIERS)
    return cache


def test_what_was_not_read_for_longest_goes():
    cache = filled(SegmentCache(3 * ROWS * (4 * CARRIERS + 48)), 1, 2, 3)
    cache.get(head(1))
    filled(cache, 4)
    assert held(cache) == [1, 3, 4]


def test_a_scan_finds_what_is_held_adds_nothing_and_keeps_its_last_piece():
    shared = filled(SegmentCache(), 1, 2)
    scan = filled(shared.for_scan(), 3, 4)
    assert held(scan) == [1, 2, 4]
    assert scan.get(head(4)) == chunk(4)
    assert held(shared) == [1, 2]
