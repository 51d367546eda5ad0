"""The judge itself: what it lets pass is true, what is a little false it refuses."""

import numpy as np
import pytest

FREQUENCY_HZ = np.linspace(954e6, 990e6, 2401)


def test_trace_that_is_a_little_false_is_refused(simulators):
    analyzer = simulators("rs")
    analyzer.ask("*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 972 MHZ;SPAN 36 MHZ;:SWE:POIN 2401;TIME 2;*OPC?")
    level_dbm = [float(field) for field in analyzer.ask(":BAND 30 KHZ;:DET RMS;:INIT;:TRAC? TRACE1").split(",")]
    analyzer.check_trace(FREQUENCY_HZ, level_dbm)
    for wrong in (np.add(level_dbm, 0.3), level_dbm[::-1], np.roll(level_dbm, 40), np.full(2401, -60.0)):
        with pytest.raises(AssertionError):
            analyzer.check_trace(FREQUENCY_HZ, wrong)
