"""Faults are spent in order, one an answer, and wait for the answer they fit."""

from analyzer_sim.lines.line_faults import LineFault, LineFaults


def test_fault_that_needs_a_block_waits_for_one() -> None:
    faults = LineFaults()
    faults.arm(LineFault.HALF_BLOCK)
    faults.arm(LineFault.RESET)
    assert faults.consume(b"1\n") is None
    assert faults.consume(b"#11a\n") is LineFault.HALF_BLOCK
    assert faults.consume(b"1\n") is LineFault.RESET
    assert faults.consume(b"1\n") is None


def test_a_silent_peer_is_silent_until_disarmed_and_spends_nothing() -> None:
    faults = LineFaults()
    faults.arm(LineFault.STALE)
    faults.is_silent_peer = True
    assert [faults.consume(b"1\n") for _ in range(3)] == [LineFault.SILENT] * 3
    assert faults.remaining == 1
    faults.is_silent_peer = False
    assert faults.consume(b"1\n") is LineFault.STALE
    faults.is_silent_peer = True
    faults.disarm()
    assert faults.consume(b"1\n") is None


def test_disarmed_faults_do_nothing() -> None:
    faults = LineFaults()
    faults.arm(LineFault.SILENT, times=3)
    assert faults.remaining == 3
    faults.disarm()
    assert faults.consume(b"1\n") is None
