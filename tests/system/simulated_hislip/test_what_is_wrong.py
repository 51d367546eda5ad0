"""HiSLIP: what a client does wrong, and faults of the line."""

import struct
import time

import numpy as np
import pytest
from analyzer_thread import AnalyzerThread
from hislip_client import (
    ASYNC_INITIALIZE,
    CLEAR,
    CLEAR_ACKNOWLEDGED,
    CLEAR_COMPLETE,
    CLEAR_DONE,
    DATA,
    DATA_END,
    ERROR,
    FATAL,
    FIRST_ID,
    IDENTITY,
    INITIALIZE,
    INITIALIZED,
    INTERRUPTED,
    LOCK,
    LOCK_INFO,
    LOCK_TOLD,
    REMOTE,
    REMOTE_DONE,
    SERVICE,
    SETUP,
    SIZE,
    Client,
    Held,
    Wire,
)

from analyzer_sim.lines.line_faults import LineFault

pytestmark = pytest.mark.system


def test_unknown_messages_are_refused_and_the_session_goes_on(client: Client) -> None:
    client.sync.say(26, 0, 0, b"descriptors")
    assert client.sync.on_input()[:2] == (ERROR, 1)
    client.sync.say(200, 0, 0, b"vendor")
    assert client.sync.on_input()[:2] == (ERROR, 3)
    client.side.say(DATA_END, 0, FIRST_ID, b"*IDN?")
    assert client.side.on_input()[:2] == (ERROR, 1), "data has no business on this channel"
    client.side.say(REMOTE, 9)
    assert client.side.on_input()[:2] == (ERROR, 2)
    client.side.say(LOCK, 2)
    assert client.side.on_input()[:2] == (ERROR, 2)
    client.side.say(SIZE, 0, 0, b"12")
    assert client.side.on_input()[:2] == (ERROR, 0)
    for control in range(7):
        client.side.say(REMOTE, control, client.last_id)
        assert client.side.on_input()[:2] == (REMOTE_DONE, 0)
    client.sync.say(ERROR, 0, 0, b"the client complains")
    assert client.ask(b"*IDN?") == IDENTITY


def test_oversize_payload_is_refused_and_skipped(client: Client) -> None:
    client.write(b"*ESE 5;" + b" " * 3_000_000)
    assert client.sync.on_input()[:2] == (ERROR, 4)
    assert client.ask(b"*ESE?") == b"0"


def test_message_of_many_parts_beyond_the_limit_is_too_much_data(client: Client) -> None:
    for _ in range(3):
        client.write(b"x" * 500_000, DATA)
    client.write(b"x")
    assert client.ask(b"SYST:ERR?").startswith(b"-223")


@pytest.mark.parametrize(
    "garbage",
    [b"GET / HTTP/1.1\r\n\r\n", b"*IDN?\n", bytes(64), struct.pack("!2sBBIQ", b"HS", 7, 0, 0, 2**64 - 1)],
)
def test_garbage_ends_its_own_session_only(analyzer: AnalyzerThread, client: Client, garbage: bytes) -> None:
    with Client(analyzer.hislip_port) as other:
        other.sync.line.sendall(garbage)
        assert other.sync.on_input()[:2] == (FATAL, 1)
        assert other.sync.is_closed()
        assert other.side.is_closed()
    with Wire(analyzer.hislip_port) as fresh:
        fresh.line.sendall(garbage)
        assert fresh.on_input().kind == FATAL
        assert fresh.is_closed()
    assert client.ask(b"*IDN?") == IDENTITY


def test_wrong_beginnings_are_fatal(analyzer: AnalyzerThread, client: Client) -> None:
    def fate(kind: int, parameter: int = 0, payload: bytes = b"") -> int:
        with Wire(analyzer.hislip_port) as wire:
            wire.say(kind, 0, parameter, payload)
            heard = wire.on_input()
            assert heard.kind == FATAL
            assert wire.is_closed()
            return heard.control

    assert fate(DATA_END, FIRST_ID, b"*IDN?") == 3
    assert fate(ASYNC_INITIALIZE, 54321) == 3
    assert fate(ASYNC_INITIALIZE, client.opened.parameter & 0xFFFF) == 3, "the session has its channel already"
    assert fate(INITIALIZE, 0x0100 << 16, b"hislip7") == 3
    with Wire(analyzer.hislip_port) as half:
        half.say(INITIALIZE, 0, 0x0100 << 16, b"hislip0")
        assert half.on_input().kind == INITIALIZED
        half.say(DATA_END, 0, FIRST_ID, b"*IDN?")
        assert half.on_input()[:2] == (FATAL, 2)
    client.sync.say(INITIALIZE, 0, 0x0100 << 16, b"hislip0")
    assert client.sync.on_input()[:2] == (FATAL, 3)
    assert client.side.is_closed()


def test_a_client_that_leaves_in_mid_sweep_leaves_the_instrument_to_others(
    held: Held, analyzer: AnalyzerThread
) -> None:
    held.allowed.clear()
    with Client(analyzer.hislip_port) as leaving:
        leaving.write(SETUP)
        leaving.write(b"INIT;*OPC?")
        held.await_sweep()
        assert leaving.sync.hears_nothing(0.05)
    with Client(analyzer.hislip_port) as client:
        assert client.ask(b"STAT:OPER:COND?") == b"32"
        client.write(b"ABOR")
        assert client.ask(b"*OPC?") == b"1"
        assert held.source.row == 0


def test_fatal_error_of_the_client_closes_both_channels(client: Client) -> None:
    client.side.say(FATAL, 0, 0, b"enough")
    assert client.side.is_closed()
    assert client.sync.is_closed()


@pytest.mark.parametrize("fault", [LineFault.RESET, LineFault.CLOSE])
def test_a_fault_that_ends_the_line_ends_both_channels(
    analyzer: AnalyzerThread, client: Client, fault: LineFault
) -> None:
    analyzer.faults.arm(fault)
    client.write(b"*IDN?")
    assert client.sync.is_closed()
    assert client.side.is_closed()


def test_a_stale_answer_has_the_old_identifier(analyzer: AnalyzerThread, client: Client) -> None:
    analyzer.faults.arm(LineFault.STALE)
    first_id = client.write(b"*ESE?")
    while analyzer.faults.remaining:
        time.sleep(0.001)
    assert client.sync.hears_nothing(0.05)
    second_id = client.write(b"*IDN?")
    heard = [client.sync.on_input() for _ in range(3)]
    assert [(message.kind, message.parameter) for message in heard] == [
        (INTERRUPTED, second_id),
        (DATA_END, first_id),
        (DATA_END, second_id),
    ]


def random_message(rng: np.random.Generator) -> bytes:
    payload = [
        b"",
        b"*IDN?\n",
        b"*OPC?;*ESE?",
        b"INIT",
        b"TRAC? TRACE1",
        bytes(8),
        bytes(rng.integers(0, 256, 40, "u1")),
    ]
    kind = int(rng.integers(2, 27))
    parameter = int(rng.choice([0, 1, FIRST_ID, 2**32 - 1]))
    chosen = payload[int(rng.integers(len(payload)))]
    length = len(chosen) if rng.random() < 0.95 else int(rng.integers(0, 2**40))
    return struct.pack("!2sBBIQ", b"HS", kind, int(rng.integers(0, 3)), parameter, length) + chosen


def test_any_messages_in_any_order_leave_the_instrument_to_others(analyzer: AnalyzerThread, client: Client) -> None:
    seed = 20261122
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    for _ in range(150):
        with Client(analyzer.hislip_port) as wild:
            try:
                for _ in range(int(rng.integers(1, 30))):
                    wire = wild.sync if rng.random() < 0.6 else wild.side
                    wire.line.sendall(random_message(rng))
            except (BrokenPipeError, ConnectionResetError):
                pass  # a fatal error has ended it
    client.write(b"ABOR;*CLS;:INIT:CONT OFF")
    assert client.ask(b"*IDN?") == IDENTITY
    client.side.say(LOCK_INFO)
    heard = client.side.on_input()
    while heard.kind == SERVICE:
        heard = client.side.on_input()
    assert heard[:3] == (LOCK_TOLD, 0, 0), "those who left hold no lock"


def test_a_client_that_reads_nothing_is_cleared_or_leaves(analyzer: AnalyzerThread, client: Client) -> None:
    with Client(analyzer.hislip_port) as deaf:
        deaf.write(SETUP + b";:SWE:POIN 100001;:INIT")
        deaf.write(b";".join([b"TRAC? TRACE1"] * 30))  # 12 MB: more than buffers on the way hold
        for _ in range(200):
            deaf.write(b"*CLS")
        assert client.ask(b"*IDN?") == IDENTITY
        deaf.side.say(CLEAR)
        while deaf.side.on_input().kind != CLEAR_ACKNOWLEDGED:
            pass
        deaf.sync.say(CLEAR_COMPLETE)
        while deaf.sync.on_input().kind != CLEAR_DONE:
            pass
        deaf.next_id, deaf.delivered = FIRST_ID, 0
        assert deaf.ask(b"*ESE?") == b"0"
        deaf.write(b";".join([b"TRAC? TRACE1"] * 30))
        deaf.write(b"*CLS")
    assert client.ask(b"*OPC?") == b"1"


def test_a_response_beyond_the_output_queue_is_a_deadlock(client: Client) -> None:
    client.write(SETUP + b";:SWE:POIN 100001;:INIT")
    client.write(b";".join([b"TRAC? TRACE1"] * 45) + b";*ESE 5")  # 18 MB
    assert client.ask(b"*ESE?;:SYST:ERR?").startswith(b'0;-430,"Query DEADLOCKED')
