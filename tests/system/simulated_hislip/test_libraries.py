"""HiSLIP: many sessions at once, and pyvisa-py."""

import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from analyzer_thread import AnalyzerThread
from hislip_client import (
    FATAL,
    IDENTITY,
    INITIALIZE,
    Client,
    Held,
    Wire,
)

from analyzer_sim.dialects.rs import RS

pytestmark = pytest.mark.system


def test_sessions_at_once_get_their_own_answers(analyzer: AnalyzerThread) -> None:
    def talk(number: int) -> int:
        with Client(analyzer.hislip_port) as client:
            return sum(client.ask(b"*IDN?;:STAT:QUES:ENAB?;:FORM?") == IDENTITY + b";0;ASC,0" for _ in range(30))

    with ThreadPoolExecutor(12) as pool:
        assert list(pool.map(talk, range(12))) == [30] * 12


def test_the_sixty_fifth_session_is_refused(analyzer: AnalyzerThread) -> None:
    clients = [Client(analyzer.hislip_port) for _ in range(64)]
    with Wire(analyzer.hislip_port) as wire:
        wire.say(INITIALIZE, 0, 0x0100 << 16, b"hislip0")
        assert wire.on_input()[:2] == (FATAL, 4)
    assert all(client.ask(b"*OPC?") == b"1" for client in clients)
    for client in clients:
        client.__exit__()


def test_pyvisa_reads_the_same_trace_in_both_formats(analyzer: AnalyzerThread) -> None:
    # the first script of section 8 of the analyzer specification, its HiSLIP part, word for word
    import pyvisa

    manager = pyvisa.ResourceManager("@py")
    i = manager.open_resource(
        f"TCPIP::127.0.0.1::hislip0,{analyzer.hislip_port}::INSTR",
        read_termination="\n",
        write_termination="\n",
        timeout=120_000,
        chunk_size=1 << 20,
    )
    i.write("*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20e6;:BAND 30 KHZ;:SWE:POIN 2001;TIME 0.2;:DET RMS")
    assert i.query("INIT;*OPC?").strip() == "1"
    i.write("FORM REAL,32")
    y = i.query_binary_values("TRAC? TRACE1", "f", is_big_endian=False, container=np.array)
    i.write("FORM ASC")
    a = np.array(i.query_ascii_values("TRAC:DATA? TRACE1"))
    assert len(y) == len(a) == 2001
    assert np.max(np.abs(y - a)) < 1e-4
    assert i.query("SYST:ERR?").startswith("0,")
    i.close()


def test_pyvisa_times_out_polls_clears_and_goes_on(held: Held, analyzer: AnalyzerThread) -> None:
    import pyvisa

    i = pyvisa.ResourceManager("@py").open_resource(
        f"TCPIP::127.0.0.1::hislip0,{analyzer.hislip_port}::INSTR",
        read_termination="\n",
        write_termination="\n",
        timeout=120_000,
    )
    held.allowed.clear()
    i.write("*RST;*CLS;*ESE 1;:INIT:CONT OFF;:SWE:POIN 501;:INIT;*OPC")
    assert i.read_stb() & 32 == 0
    i.timeout = 200
    with pytest.raises(pyvisa.VisaIOError):
        i.query("*OPC?")
    i.timeout = 120_000
    i.clear()
    assert i.query("*IDN?") == RS.identity, "no stale answer after a clear"
    held.allowed.set()
    assert i.query("*OPC?") == "1"
    assert i.query("*ESR?") == "0", "a device clear takes *OPC back"
    i.write("INIT;*OPC")
    while not i.read_stb() & 32:
        time.sleep(0.001)
    assert i.query("*ESR?") == "1"
    assert len(i.query_ascii_values("TRAC? TRACE1")) == 501
    assert i.query("SYST:ERR?").startswith("0,")
    i.close()


def test_pyvisa_never_reads_a_stale_answer_over_hislip_and_does_over_the_socket(
    held: Held, analyzer: AnalyzerThread
) -> None:
    import pyvisa

    manager = pyvisa.ResourceManager("@py")
    answers = []
    for resource in (
        f"TCPIP::127.0.0.1::hislip0,{analyzer.hislip_port}::INSTR",
        f"TCPIP::127.0.0.1::{analyzer.port}::SOCKET",
    ):
        held.allowed.clear()
        i = manager.open_resource(resource, read_termination="\n", write_termination="\n", timeout=120_000)
        i.write("*RST;*CLS;:INIT:CONT OFF;:SWE:POIN 501;:INIT")
        i.timeout = 100
        with pytest.raises(pyvisa.VisaIOError):
            i.query("*OPC?")
        held.allowed.set()
        i.timeout = 120_000
        answers.append(i.query("*IDN?"))
        i.close()
    assert answers == [RS.identity, "1"]
