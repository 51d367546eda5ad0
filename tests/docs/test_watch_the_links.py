"""Pages on links and acquisitions: they name every state of the code, and their blocks run as they stand."""

import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
from page_blocks import CRAFT

from service.api.views.links import SILENT
from service.client.service_client import ServiceClient
from service.frontend.acquisition.states import (
    ACTIONS,
    MEANINGS,
    TRANSITIONS,
    AcquisitionEvent,
    AcquisitionState,
    diagram,
    reference_page,
)
from service.frontend.link_report import RUNNING, SERVICE_AWAY
from service.records.operations.link import STOPPED

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = DOCS / "how-to" / "watch-the-links.md"
STATES = DOCS / "reference" / "acquisition-states.md"
#: told in place of the state of an acquisition that hangs
STUCK = "STUCK"
CARRIER = {"id": "b0", "band": "Ku", "transponder": "Ku1", "downlink_hz": 11.2e9, "bandwidth_hz": 1e3, "kind": "beacon"}
EPOCH = "2026-11-21T03:00:00.000000Z"
TRACE = {
    "epoch": EPOCH,
    "sweep": "ku",
    "start_hz": 954e6,
    "step_hz": 15e3,
    "rbw_hz": 30e3,
    "enbw_hz": 31e3,
    "sweep_time_s": 2.0,
    "power_dbm": [-90.0, -60.5, None],
}
REPORT = {
    "id": "yamal-202.sa-1",
    "kind": "analyzer",
    "spacecraft_id": "yamal-202",
    "source": "sa-1",
    "state": "MEASURE",
}


def test_the_page_names_every_state_and_no_other() -> None:
    table = PAGE.read_text().partition("## What each state means")[2].partition("`reported_state`")[0]
    named = re.findall(r"^\| `([A-Z_]+)` \| \S", table, re.MULTILINE)
    assert len(named) == len(set(named))
    assert set(named) == {state.name for state in AcquisitionState} | {STUCK, RUNNING, SERVICE_AWAY, SILENT, STOPPED}


@pytest.mark.system
@pytest.mark.slow
def test_the_blocks_run_as_they_stand(service: Any, tmp_path: Path) -> None:
    blocks = re.findall(r"^```bash\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    with ServiceClient(service.url, service.environment["SOO_KEY"], retries=6, timeout_s=120) as client:
        client.create_spacecraft(CRAFT)
        plan_id = client.put_carriers("yamal-202", [CARRIER])["plan_id"]
        row = {"epoch": EPOCH, "power_dbm": [-42.0], "flags": [16], "sigma_db": [0.05]}
        client.post_measurements("yamal-202", plan_id, [row], source="sa-1", first_seq=1)
        client.post_traces("yamal-202", "sa-1", [TRACE])
        assert client.report_links([REPORT]) == [{"id": "yamal-202.sa-1", "enabled": True, "reset": 0}]
        printed = [run(block, service.environment, tmp_path) for block in blocks]
        assert '"state":"MEASURE"' in printed[0]
        assert ['"enabled":false' in text for text in printed[:4]] == [False, True, False, False]
        assert '"NO_CARRIER"' in printed[4]
        assert printed[5].splitlines() == [
            "frequency_hz,power_dbm",
            "954000000.0,-90.0",
            "954015000.0,-60.5",
            "954030000.0,",
        ]
        assert client.report_links([REPORT]) == [{"id": "yamal-202.sa-1", "enabled": True, "reset": 1}]


def run(block: str, environment: dict[str, str], folder: Path) -> str:
    """Run a block and return what it printed."""
    script = f"set -euo pipefail\n{block}"
    done = subprocess.run(
        ["bash", "-c", script], env=environment, cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, f"{block}\n{done.stderr}"
    return done.stdout


def test_page_of_states_is_the_table() -> None:
    assert STATES.read_text() == reference_page()


def test_page_of_states_names_every_state_and_event_and_draws_every_change() -> None:
    page = reference_page()
    assert set(ACTIONS) == set(AcquisitionState)
    assert set(MEANINGS) == set(AcquisitionEvent)
    assert all(f"| {state.name} |" in page for state in AcquisitionState)
    for state, row in TRANSITIONS.items():
        for event, target in row.items():
            if target is not state:
                (line,) = [each for each in diagram().splitlines() if f"{state.name} --> {target.name}:" in each]
                assert event.name in line
