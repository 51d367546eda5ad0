"""Token buckets: bursts, refill, classes, addresses."""

import pytest

from service.api.limits.rate_limits import MAX_ADDRESSES, RateClass, RateLimitConfig, RateLimits, class_of, network_of


class Time:
    """A time that a test moves."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def time():
    return Time()


def limits(time, **config):
    return RateLimits(RateLimitConfig(**config), time)


def test_a_burst_passes_and_then_the_rate(time):
    found = limits(time, read_per_s=2.0, read_burst=3)
    took = [found.consume("k", RateClass.READ) for _ in range(4)]
    assert [each.is_allowed for each in took] == [True, True, True, False]
    assert [each.remaining for each in took] == [2, 1, 0, 0]
    assert [each.reset_s for each in took] == [1, 1, 2, 1]
    time.now_s += 0.5
    assert found.consume("k", RateClass.READ).is_allowed
    assert not found.consume("k", RateClass.READ).is_allowed
    time.now_s += 1000.0
    assert [found.consume("k", RateClass.READ).is_allowed for _ in range(4)] == [True, True, True, False]


def test_over_a_long_time_the_rate_is_kept(time):
    found = limits(time, control_per_s=5.0, control_burst=10)
    passed = 0
    for _ in range(2000):
        passed += found.consume("k", RateClass.CONTROL).is_allowed
        time.now_s += 0.01
    assert 10 + 5.0 * 20 - 1 <= passed <= 10 + 5.0 * 20


def test_keys_and_classes_do_not_take_from_each_other(time):
    found = limits(time, read_per_s=1.0, read_burst=1)
    assert found.consume("a", RateClass.READ).is_allowed
    assert found.consume("b", RateClass.READ).is_allowed
    assert found.consume("a", RateClass.CONTROL).is_allowed
    assert not found.consume("a", RateClass.READ).is_allowed


def test_zero_is_no_limit(time):
    found = limits(time, ingest_per_s=0.0, anonymous_per_s=0.0)
    assert (found.consume("a", RateClass.INGEST), found.consume_anonymous("192.0.2.1")) == (None, None)


def test_addresses_are_counted_apart_and_forgotten_in_time(time):
    found = limits(time, anonymous_per_s=0.001, anonymous_burst=1)
    assert found.consume_anonymous("192.0.2.1").is_allowed
    assert not found.consume_anonymous("192.0.2.1").is_allowed
    assert found.consume_anonymous("192.0.2.2").is_allowed
    for k in range(MAX_ADDRESSES + 5):
        found.consume_anonymous(f"10.{k >> 16}.{k >> 8 & 255}.{k & 255}")
    assert len(found._addresses) == MAX_ADDRESSES
    assert found.consume_anonymous("192.0.2.1").is_allowed


@pytest.mark.parametrize(
    ("address", "network"),
    [
        ("192.0.2.1", "192.0.2.1"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2"),
        ("2001:db8::1", "2001:db8:0:0"),
        ("::1", "0:0:0:0"),
        ("fe80::", "fe80:0:0:0"),
        ("::ffff:192.0.2.1", "::ffff:192.0.2.1"),
        ("", ""),
        ("unix socket", "unix socket"),
    ],
)
def test_one_client_has_a_whole_network_of_addresses(address, network):
    assert network_of(address) == network


@pytest.mark.parametrize(
    ("method", "path", "wanted"),
    [
        ("GET", "/api/v1/spacecraft", "read"),
        ("HEAD", "/api/v1/spacecraft", "read"),
        ("GET", "/api/v1/spacecraft/a/archive/attitude:export", "export"),
        ("POST", "/api/v1/spacecraft/a/corrections:batch", "ingest"),
        ("POST", "/api/v1/spacecraft/a/traces", "ingest"),
        ("GET", "/api/v1/spacecraft/a/traces", "read"),
        ("POST", "/api/v1/links:report", "ingest"),
        ("POST", "/api/v1/spacecraft", "control"),
        ("DELETE", "/api/v1/keys/x", "control"),
    ],
)
def test_classes(method, path, wanted):
    assert class_of(method, path) == wanted
