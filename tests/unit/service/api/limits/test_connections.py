"""Open connections: bounded of one address and in all, forgotten when they end, refusals logged now and then."""

import logging

import pytest

from service.api.limits.connections import Connections


@pytest.fixture
def clock():
    """A clock that a test sets."""
    return [0.0]


def test_an_address_has_so_many_and_gets_room_back(clock):
    connections = Connections(10, 2, "", lambda: clock[0])
    assert [connections.admit("192.0.2.1") is None for _ in range(3)] == [True, True, False]
    assert connections.admit("192.0.2.2") is None
    connections.leave("192.0.2.1")
    assert connections.admit("192.0.2.1") is None
    assert (connections.count, connections.refused) == (3, {"address": 1})


def test_addresses_of_one_ipv6_network_are_one(clock):
    connections = Connections(10, 1, "", lambda: clock[0])
    assert connections.admit("2001:db8:1:2::1") is None
    assert "SOO_MAX_CONNECTIONS_PER_ADDRESS" in connections.admit("2001:db8:1:2::2")
    assert connections.admit("2001:db8:1:3::1") is None


def test_trusted_proxies_have_the_limit_of_all_alone(clock):
    connections = Connections(4, 1, "10.0.0.0/8, 192.0.2.9", lambda: clock[0])
    assert [connections.admit(address) for address in ("10.1.2.3", "10.1.2.3", "192.0.2.9", "192.0.2.9")] == [None] * 4
    assert "SOO_MAX_CONNECTIONS)" in connections.admit("10.1.2.3")
    assert connections.refused == {"total": 1}
    # the address of a local socket is none
    connections.leave("10.1.2.3")
    assert connections.admit("") is None


def test_refusals_are_logged_every_ten_seconds_with_their_number(clock, caplog):
    connections = Connections(10, 1, "", lambda: clock[0])
    connections.admit("192.0.2.1")
    with caplog.at_level(logging.WARNING):
        for second in range(25):
            clock[0] = float(second)
            connections.admit("192.0.2.1")
    texts = [record.getMessage() for record in caplog.records]
    assert [text.partition(";")[0] for text in texts] == [
        "connections refused or closed: 1",
        "connections refused or closed: 10",
        "connections refused or closed: 10",
    ]
    assert all("192.0.2.1" in text for text in texts)
