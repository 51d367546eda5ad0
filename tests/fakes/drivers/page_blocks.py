"""Parts of the tests of how-to pages: the spacecraft that pages speak of, and their blocks run as they stand."""

import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

CRAFT = {
    "id": "yamal-202",
    "name": "Yamal-202",
    "longitude_deg": 90.0,
    "simulated": True,
    "receiving_site": {"name": "site", "latitude_deg": 55.0, "longitude_deg": 38.0, "height_m": 200.0},
    "inertia_kg_m2": [[4000, 0, 0], [0, 2000, 0], [0, 0, 4000]],
    "torque_limit_n_m": 0.05,
}
CARRIERS = [
    {"id": each, "band": "Ku", "transponder": "Ku1", "downlink_hz": 11.2e9, "bandwidth_hz": 1e3, "kind": "beacon"}
    for each in ("c00", "c01")
]


def blocks(page: Path) -> list[tuple[str, str]]:
    """Return language and text of every block that can be run; commands of a console each on their own."""
    found = re.findall(r"^```(bash|python|console)\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    return [
        (language, command)
        for language, text in found
        for command in (re.findall(r"^\$ (soo .*)$", text, re.MULTILINE) if language == "console" else [text])
    ]


def run_blocks(page: Path, wanted: Sequence[tuple[str, str]], environment: Mapping[str, str], folder: Path) -> None:
    """Run every block of a page in a folder and find what each must print; ``wanted`` is (language, text) in order."""
    assert [language for language, _ in blocks(page)] == [language for language, _ in wanted]
    for (language, text), (_, printed) in zip(blocks(page), wanted, strict=True):
        if language == "python":
            command = [sys.executable, "-c", text]
        else:
            command = ["bash", "-c", text.strip() + (" --json" if language == "console" else "")]
        done = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, f"{text}\n{done.stdout}\n{done.stderr}"
        assert printed in done.stdout, f"{text}\n{done.stdout}"
