"""Rate limits: token buckets by key and class of request, and by address for those who have no key.

A bucket holds up to ``burst`` tokens and gains ``per_s`` of them a second; a request takes one. The defaults are far
above what operation needs: they stop a program that runs wild, not people at work.
"""

import math
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from service.records.setting import CHOSEN, setting

#: addresses remembered at once; the one longest unheard of goes first
MAX_ADDRESSES = 4096
_SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
#: ends of the paths that stations send to
_INGEST_ENDS = (":batch", ":report", "/traces")
#: ends of the paths that may read the whole archive
_EXPORT_ENDS = (":export", ":manifest")


class RateClass(StrEnum):
    """Rate class of a request by its approximate cost."""

    INGEST = "ingest"
    READ = "read"
    EXPORT = "export"
    CONTROL = "control"
    #: without a valid key, by address
    ANONYMOUS = "anonymous"
    #: files of the console, by address: a page is some dozens of them, and operators may share an address
    STATIC = "static"


@dataclass(frozen=True, slots=True)
class RateLimitConfig:
    """Requests a second and burst of each class; 0 a second = no limit."""

    ingest_per_s: float = setting(
        5000.0, "batches, traces and reports of stations: requests a second of one key; 0 = no limit", CHOSEN
    )
    ingest_burst: int = setting(10_000, "the same: requests at once", CHOSEN)
    read_per_s: float = setting(500.0, "what is read: requests a second of one key; 0 = no limit", CHOSEN)
    read_burst: int = setting(2000, "the same: requests at once", CHOSEN)
    export_per_s: float = setting(10.0, "exports: requests a second of one key; 0 = no limit", CHOSEN)
    export_burst: int = setting(100, "the same: requests at once", CHOSEN)
    control_per_s: float = setting(50.0, "every other change: requests a second of one key; 0 = no limit", CHOSEN)
    control_burst: int = setting(1000, "the same: requests at once", CHOSEN)
    anonymous_per_s: float = setting(
        20.0, "requests without a valid key, by address: requests a second; 0 = no limit", CHOSEN
    )
    anonymous_burst: int = setting(200, "the same: requests at once", CHOSEN)
    static_per_s: float = setting(200.0, "files of the console, by address: requests a second; 0 = no limit", CHOSEN)
    static_burst: int = setting(2000, "the same: requests at once", CHOSEN)


class Allowance(NamedTuple):
    """Answer of a token bucket to one request."""

    is_allowed: bool
    limit: int
    remaining: int
    #: until the bucket is full again, or until the next token when the request is refused
    reset_s: int


class Bucket:
    """One token bucket.

    Parameters
    ----------
    per_s : float
        Tokens gained a second.
    burst : int
        Tokens held at most; a bucket starts full.
    now_s : float
        Monotonic time.
    """

    __slots__ = ("_burst", "_per_s", "_tokens", "_touched_s")

    def __init__(self, per_s: float, burst: int, now_s: float) -> None:
        self._per_s = per_s
        self._burst = max(burst, 1)
        self._tokens = float(self._burst)
        self._touched_s = now_s

    def consume(self, now_s: float) -> Allowance:
        """Take a token when there is one."""
        gained = (now_s - self._touched_s) * self._per_s
        self._tokens = min(self._tokens + gained, self._burst)
        self._touched_s = now_s
        if self._tokens < 1.0:
            return Allowance(False, self._burst, 0, math.ceil((1.0 - self._tokens) / self._per_s))
        self._tokens -= 1.0
        return Allowance(True, self._burst, int(self._tokens), math.ceil((self._burst - self._tokens) / self._per_s))


class RateLimits:
    """The buckets of one process.

    Parameters
    ----------
    config : RateLimitConfig
        Rates and bursts.
    monotonic_s : callable
        Gives the time.
    """

    def __init__(self, config: RateLimitConfig, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._monotonic_s = monotonic_s
        self._rates = {
            each: (float(getattr(config, f"{each}_per_s")), int(getattr(config, f"{each}_burst"))) for each in RateClass
        }
        #: of keys; only valid ones get here, so there are no more than keys times classes
        self._keys: dict[tuple[str, RateClass], Bucket] = {}
        self._addresses: OrderedDict[tuple[str, RateClass], Bucket] = OrderedDict()

    def consume(self, key_id: str, wanted: RateClass) -> Allowance | None:
        """Count a request of a key; None where there is no limit."""
        per_s, burst = self._rates[wanted]
        if per_s <= 0:
            return None
        now_s = self._monotonic_s()
        bucket = self._keys.get((key_id, wanted))
        if bucket is None:
            bucket = self._keys[key_id, wanted] = Bucket(per_s, burst, now_s)
        return bucket.consume(now_s)

    def consume_anonymous(self, address: str, wanted: RateClass = RateClass.ANONYMOUS) -> Allowance | None:
        """Count a request without a valid key; None where there is no limit."""
        per_s, burst = self._rates[wanted]
        if per_s <= 0:
            return None
        now_s = self._monotonic_s()
        name = network_of(address), wanted
        bucket = self._addresses.pop(name, None) or Bucket(per_s, burst, now_s)
        self._addresses[name] = bucket
        if len(self._addresses) > MAX_ADDRESSES:
            self._addresses.popitem(last=False)
        return bucket.consume(now_s)


def class_of(method: str, path: str) -> RateClass:
    """Return the class of a request that has a key.

    Examples
    --------
    >>> str(class_of("POST", "/api/v1/spacecraft/a/measurements:batch"))
    'ingest'
    """
    if method in _SAFE_METHODS:
        return RateClass.EXPORT if path.endswith(_EXPORT_ENDS) else RateClass.READ
    return RateClass.INGEST if path.endswith(_INGEST_ENDS) else RateClass.CONTROL


def network_of(address: str) -> str:
    """Return what is counted as one client: an IPv4 address, or the /64 of an IPv6 address.

    Examples
    --------
    >>> network_of("2001:db8:1:2:3:4:5:6"), network_of("192.0.2.7")
    ('2001:db8:1:2', '192.0.2.7')
    """
    if ":" not in address or "." in address:
        return address
    head, _, tail = address.partition("::")
    groups = head.split(":") if head else []
    missing = 8 - len(groups) - (len(tail.split(":")) if tail else 0)
    return ":".join([*groups, *["0"] * missing][:4])
