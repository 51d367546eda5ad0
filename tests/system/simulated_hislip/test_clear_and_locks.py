"""HiSLIP: device clear, trigger and locks."""

import socket
import time

import pytest
from analyzer_thread import AnalyzerThread
from hislip_client import (
    CLEAR,
    CLEAR_ACKNOWLEDGED,
    CLEAR_COMPLETE,
    CLEAR_DONE,
    DATA,
    FIRST_ID,
    IDENTITY,
    LOCK,
    LOCK_INFO,
    LOCK_TOLD,
    SETUP,
    TRIGGER,
    Client,
    Held,
)

pytestmark = pytest.mark.system


def test_device_clear_in_mid_sweep(held: Held, client: Client) -> None:
    held.allowed.clear()
    client.write(SETUP + b";:INIT")
    client.write(b"*OPC?")
    client.write(b"*IDN", DATA)
    held.await_sweep()
    assert client.sync.hears_nothing()
    client.clear()
    assert client.ask(b"*ESE?;:STAT:OPER:COND?") == b"0;32", "the session is free, the sweep still waits"
    held.allowed.set()
    assert client.ask(b"*OPC?") == b"1"
    assert held.source.row == 1
    assert len(client.ask(b"TRAC? TRACE1")) == len("#49604") + 4 * 2401


def test_device_clear_drops_what_was_sent_before_it(client: Client) -> None:
    client.write(b"*ESE?")
    client.side.say(CLEAR)
    assert client.side.on_input().kind == CLEAR_ACKNOWLEDGED
    client.write(b"*ESE 77;*IDN?")
    client.sync.say(CLEAR_COMPLETE)
    heard = [client.sync.on_input()]
    while heard[-1].kind != CLEAR_DONE:
        heard.append(client.sync.on_input())
    assert IDENTITY + b"\n" not in {message.payload for message in heard}
    client.next_id, client.delivered = FIRST_ID, 0
    assert client.ask(b"*ESE?;:SYST:ERR:COUN?") == b"0;0"


def test_device_clear_again_and_again(client: Client) -> None:
    for _ in range(20):
        client.write(b"*IDN?")
        client.clear()
    assert client.ask(b"*OPC?") == b"1"


def test_trigger_starts_a_sweep_in_its_turn(held: Held, client: Client) -> None:
    client.write(SETUP)
    client.write(b"", TRIGGER)
    assert client.ask(b"*OPC?") == b"1"
    assert held.source.row == 1


# locks


def test_exclusive_lock_holds_the_others_back_until_it_is_given_back(analyzer: AnalyzerThread, client: Client) -> None:
    assert client.lock() == 1
    with Client(analyzer.hislip_port) as other:
        assert other.lock() == 0, "no patience, no lock"
        other.write(b"*ESE 9;*ESE?")
        assert other.sync.hears_nothing()
        assert other.status() & 16 == 0, "status is told to everybody"
        other.side.say(LOCK_INFO)
        assert other.side.on_input()[:3] == (LOCK_TOLD, 1, 1)
        assert client.ask(b"*ESE?") == b"0"
        client.write(b"*ESE 3")
        assert client.unlock() == 1, "released after the message sent under it"
        assert other.read() == b"9"
    assert client.unlock() == 3


def test_a_lock_is_waited_for_as_long_as_asked(analyzer: AnalyzerThread, client: Client) -> None:
    assert client.lock() == 1
    with Client(analyzer.hislip_port) as other:
        began_s = time.monotonic()
        assert other.lock(timeout_ms=150) == 0
        assert time.monotonic() - began_s > 0.14
        other.side.say(LOCK, 1, 120_000)
        assert other.side.hears_nothing(0.05)
        assert client.unlock() == 1
        assert other.lock_answer() == 1


def test_shared_locks_and_a_lock_on_top(analyzer: AnalyzerThread, client: Client) -> None:
    with Client(analyzer.hislip_port) as second, Client(analyzer.hislip_port) as stranger:
        assert client.lock(key=b"crew") == 1
        assert second.lock(key=b"crew") == 1
        assert stranger.lock(key=b"other") == 0
        assert (client.ask(b"*OPC?"), second.ask(b"*OPC?")) == (b"1", b"1")
        stranger.write(b"*OPC?")
        assert stranger.sync.hears_nothing(0.05)
        assert second.lock() == 1
        client.side.say(LOCK_INFO)
        assert client.side.on_input()[:3] == (LOCK_TOLD, 1, 2)
        assert (second.unlock(), second.unlock(), client.unlock()) == (1, 2, 2)
        assert stranger.read() == b"1"


def test_a_client_that_leaves_takes_its_lock_along(analyzer: AnalyzerThread, client: Client) -> None:
    with Client(analyzer.hislip_port) as other:
        assert other.lock() == 1
        client.write(b"*OPC?")
        assert client.sync.hears_nothing(0.05)
    assert client.read() == b"1"


def test_the_raw_socket_is_held_back_by_a_lock(analyzer: AnalyzerThread, client: Client) -> None:
    assert client.lock() == 1
    with socket.create_connection(("127.0.0.1", analyzer.port), timeout=0.1) as line:
        line.sendall(b"*OPC?\n")
        with pytest.raises(TimeoutError):
            line.recv(10)
        assert client.unlock() == 1
        line.settimeout(120.0)
        assert line.recv(10) == b"1\n"
