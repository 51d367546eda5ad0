"""What must become of fuzzed rows: batches of one source, and the plainest account of what each row deserves.

It shares no code with the service: contents are tuples, epochs are Python integers, rows stand in a dictionary.
"""

import random
import struct
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

LEAP_FLAG = 1 << 23
DETAILS = {
    "sigma_db": "measured_sigma_db",
    "c_n0_db_hz": "c_n0_db_hz",
    "occupied_bandwidth_hz": "occupied_bandwidth_hz",
    "centroid_offset_hz": "centroid_offset_hz",
}
#: instant behind the leap second, microseconds UTC
NEW_YEAR_US = 1_483_228_800_000_000
Content = tuple[Any, ...]


@dataclass
class Sent:
    """One request: its body, and the epoch of each row, in a leap second or not."""

    body: dict[str, Any]
    epochs: list[tuple[int, bool]]
    #: code of the problem that refuses all of it
    problem: str | None = None


@dataclass
class Oracle:
    """What one source has stored: first content of each epoch."""

    widths: dict[int, int]
    rows: dict[int, Content] = field(default_factory=dict)
    seqs: dict[int, int | None] = field(default_factory=dict)

    def account(self, sent: Sent) -> list[str]:
        """Take a request in and return what becomes of each row: accepted, duplicate, or the code of a refusal."""
        if sent.problem is not None:
            return []
        first = sent.body.get("first_seq")
        return [
            self._one(row, sent.body["plan_id"], *epoch, None if first is None else first + position)
            for position, (row, epoch) in enumerate(zip(sent.body["measurements"], sent.epochs, strict=True))
        ]

    def _one(self, row: dict[str, Any], plan_id: int, epoch_us: int, is_leap: bool, seq: int | None) -> str:
        width = self.widths[plan_id]
        stated = [row[name] for name in ("flags", *DETAILS) if row.get(name) is not None]
        if any(len(values) != width for values in (row["power_dbm"], *stated)):
            return "value.count"
        if epoch_us < 946_684_800_000_000:
            return "time.too_old"
        if epoch_us > 4_102_444_800_000_000:
            return "time.future"
        if any(power is not None and not -250 <= power <= 50 for power in row["power_dbm"]):
            return "value.out_of_range"
        content = content_of(row, plan_id, is_leap=is_leap)
        for place_us, reported in ((epoch_us, content), (epoch_us + 1, marked(content, width))):
            known = self.rows.get(place_us)
            if known is None:
                self.rows[place_us], self.seqs[place_us] = reported, seq
                return "accepted"
            if known == reported:
                return "duplicate"
            if not (has_leap(known) or has_leap(content)):
                break
        return "measurement.conflict"


def content_of(row: dict[str, Any], plan_id: int, *, is_leap: bool = False) -> Content:
    """Return plan, powers, flags and details of a row as they compare."""
    flags = None if row.get("flags") is None else tuple(row["flags"])
    details = []
    for name in DETAILS:
        values = singles(row.get(name) or [])
        details.append(None if all(value is None for value in values) else values)
    content = (plan_id, singles(row["power_dbm"]), flags, tuple(details))
    return marked(content, len(row["power_dbm"])) if is_leap else content


def singles(values: list[float | None]) -> tuple[float | None, ...]:
    """Return values in single precision, without a negative zero."""
    return tuple(None if each is None else struct.unpack("<f", struct.pack("<f", each))[0] + 0.0 for each in values)


def marked(content: Content, width: int) -> Content:
    """Return a content with the flag of a leap second on each carrier."""
    plan_id, powers, flags, details = content
    return plan_id, powers, tuple(flag | LEAP_FLAG for flag in flags or (0,) * width), details


def has_leap(content: Content) -> bool:
    """Tell whether a content bears the flag of a leap second."""
    return any(flag & LEAP_FLAG for flag in content[2] or ())


class Fuzzer:
    """Batches of one source, good and bad, drawn from a seed."""

    def __init__(self, seed: str, source: str, widths: dict[int, int]) -> None:
        self._dice = random.Random(f"{seed} {source}")
        self._source = source
        self._widths = widths
        self._now_us = NEW_YEAR_US - 30_000_000
        self._seq = 0
        self._past: list[tuple[int, dict[str, Any], tuple[int, bool]]] = []

    def batch(self) -> Sent:
        """Return the next request."""
        dice = self._dice
        plan_id = dice.choice([*self._widths, 1, 1, 1])
        rows, epochs = [], []
        for _ in range(dice.choice([1, 1, 2, 5, 20, 60])):
            row, epoch = self._row(plan_id)
            rows.append(row)
            epochs.append(epoch)
        if dice.random() < 0.15:
            order = list(range(len(rows)))
            dice.shuffle(order)
            rows, epochs = [rows[k] for k in order], [epochs[k] for k in order]
        body: dict[str, Any] = {"plan_id": plan_id, "source": self._source, "measurements": rows}
        if dice.random() < 0.8:
            self._seq = dice.choice([self._seq, self._seq, self._seq, self._seq + 7, 0, 2**51 + self._seq % 1000])
            body["first_seq"] = self._seq
            self._seq += len(rows)
        return self._spoiled(Sent(body, epochs))

    def _row(self, plan_id: int) -> tuple[dict[str, Any], tuple[int, bool]]:
        dice, width = self._dice, self._widths[plan_id]
        kind = dice.random()
        if self._past and kind < 0.3:
            of_plan, row, epoch = dice.choice(self._past[-200:])
            if of_plan == plan_id or kind < 0.05:
                return self._changed(dict(row)) if kind < 0.12 else dict(row), epoch
        self._now_us += dice.choice([1, 1000, 10_000, 250_000, 1_000_000])
        epoch_us = self._now_us if kind < 0.9 else self._now_us - dice.randrange(5_000_000)
        is_leap = NEW_YEAR_US <= epoch_us < NEW_YEAR_US + 1_000_000 and dice.random() < 0.5
        if kind > 0.995:
            epoch_us = dice.choice([946_684_799_999_999, 4_102_444_800_000_001])
        elif kind > 0.99:
            self._now_us = min(self._now_us, NEW_YEAR_US - 2_000_000)
        text, epoch_us = self._text(epoch_us, is_leap=is_leap)
        row: dict[str, Any] = {"epoch": text, "power_dbm": self._values(width, -60.0, [-0.0, 0.0, None, -42.1])}
        if dice.random() < 0.4:
            row["flags"] = [dice.choice([0, 0, 0, 16, 1 << 22]) for _ in range(width)]
        for name, scale in zip(DETAILS, (0.1, 70.0, 36e3, -120.0), strict=True):
            if dice.random() < 0.15:
                row[name] = self._values(width, scale, [None, None, 0.0])
        self._past.append((plan_id, row, (epoch_us, is_leap)))
        return row, (epoch_us, is_leap)

    def _values(self, width: int, scale: float, odd: list[float | None]) -> list[float | None]:
        dice = self._dice
        return [dice.choice(odd) if dice.random() < 0.1 else scale * (1 + dice.random() / 9) for _ in range(width)]

    def _changed(self, row: dict[str, Any]) -> dict[str, Any]:
        """Return a row of a known epoch with something else in it, or the same said otherwise."""
        what, width = self._dice.randrange(7), len(row["power_dbm"])
        if what == 0:
            row["power_dbm"] = [*row["power_dbm"][:-1], -77.25]
        elif what == 1:
            row["flags"] = None if row.get("flags") else [0] * width
        elif what == 2:
            row["sigma_db"] = None if row.get("sigma_db") else [0.25] * width
        elif what == 3:
            row["power_dbm"] = [-each if each == 0 else each for each in row["power_dbm"]]
        elif what == 4:
            row["c_n0_db_hz"] = row.get("c_n0_db_hz") or [None] * width
        elif what == 5:
            row["power_dbm"] = row["power_dbm"][1:]
        else:
            row["power_dbm"] = [99.0, *row["power_dbm"][1:]]
        return row

    def _text(self, epoch_us: int, *, is_leap: bool) -> tuple[str, int]:
        """Return an epoch as text, with digits below the microsecond now and then, and what it is rounded to."""
        dice = self._dice
        moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=epoch_us)
        fraction = moment.microsecond
        extra, more_us = dice.choice([("", 0), ("", 0), ("", 0), ("4999999", 0), ("50000000000001", 1), ("123", 0)])
        if fraction == 999_999:
            extra, more_us = "", 0
        if is_leap:
            return f"2016-12-31T23:59:60.{fraction:06d}{extra}Z", epoch_us + more_us
        if dice.random() < 0.1:
            shifted = moment + timedelta(hours=5, minutes=30)
            return f"{shifted:%Y-%m-%dT%H:%M:%S}.{fraction:06d}{extra}+05:30", epoch_us + more_us
        return f"{moment:%Y-%m-%dT%H:%M:%S}.{fraction:06d}{extra}Z", epoch_us + more_us

    def _spoiled(self, sent: Sent) -> Sent:
        """Return a request, now and then with a fault for which all of it is refused."""
        if self._dice.random() > 0.06:
            return sent
        row = dict(self._dice.choice(sent.body["measurements"]))
        fault, code = self._dice.choice(
            [
                ({"sigma_db": [-1.0]}, "value.range"),
                ({"sigma_db": [1e15]}, "value.range"),
                ({"epoch": "2017-01-01T12:30:60Z"}, "epoch.malformed"),
                ({"epoch": "2017-02-30T00:00:00Z"}, "epoch.malformed"),
                ({"flags": [-1]}, "value.range"),
                ({"power": []}, "field.unknown"),
                (None, "value.range"),
                ({}, "plan.unknown"),
            ]
        )
        body = dict(sent.body)
        if fault is None:
            body["first_seq"] = 2**53
        elif fault:
            body["measurements"] = [*sent.body["measurements"], row | fault]
        else:
            body["plan_id"] = 77
        return Sent(body, [], code)
