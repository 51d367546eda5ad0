"""easy-scpi: headers made from attribute names, in the long or the short form as the user types them."""

import easy_scpi
import numpy as np
import pytest


def dialects(work):
    return [
        pytest.param(
            transport, id=transport, marks=pytest.mark.client("easy-scpi", transport=transport, dialect="rs", work=work)
        )
        for transport in ("socket", "HiSLIP")
    ]


@pytest.mark.parametrize("transport", dialects("attributes as headers: settings, sweep, trace, error queue"))
def test_easy_scpi(analyzer, transport):
    name = analyzer.resource_name(transport)
    client = easy_scpi.Instrument(
        port=name, port_match=False, backend="@py", read_termination="\n", write_termination="\n", timeout=120_000
    )
    client.rid = name
    client.connect()
    assert client.id.startswith("Rohde&Schwarz,")
    client.initiate.cont("OFF")
    client.sense.frequency.center("972 MHz")
    client.freq.span(36e6)
    client.band(30e3)
    client.swe.poin(2401)
    client.sweep.time(2)
    client.det("RMS")
    assert float(client.sense.frequency.start()) == 954e6
    client.init()
    assert client.query("*OPC?") == "1"
    level_dbm = [float(field) for field in client.trac.data("TRACE1", query=True).split(",")]
    analyzer.check_trace(np.linspace(954e6, 990e6, 2401), level_dbm)
    assert client.syst.err() == '0,"No error"'
    client.none.such(1)
    assert client.syst.err().startswith("-113,")
    client.disconnect()
