"""The tutorial's blocks run as they stand against a real service, and answer what the tutorial shows."""

import re
import subprocess
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
TUTORIAL = ROOT / "docs" / "tutorials" / "first-fix.md"
AXES = ("yaw", "roll", "pitch")
MARK = "@@@ block"
#: a decimal shown in the tutorial and the one of this machine may differ by another sum order, never by this much
DECIMAL_TOLERANCE = 0.02
#: bash block, and the text block that directly follows it
_BLOCK = re.compile(r"^```bash\n(?P<code>.*?)^```\n(?:```text\n(?P<shown>.*?)^```\n)?", re.DOTALL | re.MULTILINE)
_DECIMAL = re.compile(r"[-+]?\d+\.\d+(?!\d|\.|:)")


def blocks() -> list[tuple[str, str | None]]:
    """Return each executable block with the output that the tutorial shows for it."""
    return [(match["code"], match["shown"]) for match in _BLOCK.finditer(TUTORIAL.read_text())]


def is_as_shown(shown: str, printed: str) -> bool:
    """Whether a printed line is the shown one: ``...`` stands for anything, decimals may differ a little."""
    pattern = re.escape(_DECIMAL.sub("#", shown)).replace(re.escape("..."), ".*")
    if not re.fullmatch(pattern, _DECIMAL.sub("#", printed)):
        return False
    if "..." in shown:
        return True
    pairs = zip(_DECIMAL.findall(shown), _DECIMAL.findall(printed), strict=True)
    return all(abs(float(wanted) - float(found)) <= DECIMAL_TOLERANCE for wanted, found in pairs)


@pytest.mark.parametrize(
    ("shown", "printed", "is_same"),
    [
        ("1 16 200", "1 16 200", True),
        ("1 16 200", "1 16 201", False),
        ('1 "active" 200', '1 "draft" 200', False),
        ("roll: rms error 0.041 deg", "roll: rms error 0.043 deg", True),
        ("roll: rms error 0.041 deg", "roll: rms error 0.141 deg", False),
        ('{"method": "paper", ...} 201', '{"method": "paper", "mode": "ground"} 201', True),
        ('{"method": "paper", ...} 201', '{"method": "paper", "mode": "ground"} 409', False),
    ],
)
def test_lines_are_compared_as_a_reader_would(shown: str, printed: str, is_same: bool) -> None:
    assert is_as_shown(shown, printed) is is_same


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.timeout(120)  # 15 s alone; the machine may be busy with other tests
def test_tutorial_runs_and_answers_what_it_shows(service: Any, tmp_path: Path) -> None:
    script = "set -euo pipefail\n" + "".join(f"echo '{MARK} {k}'\n{code}" for k, (code, _) in enumerate(blocks()))
    folder = tmp_path / "tutorial"
    folder.mkdir()
    result = subprocess.run(
        ["bash", "-c", script], cwd=folder, env=service.environment, capture_output=True, text=True, timeout=110
    )
    assert result.returncode == 0, result.stdout + result.stderr
    outputs = re.split(rf"^{MARK} \d+\n", result.stdout, flags=re.MULTILINE)[1:]
    assert len(outputs) == len(blocks()) >= 15, result.stdout
    for (code, shown), printed in zip(blocks(), outputs, strict=True):
        wanted, found = (shown or "").splitlines(), printed.splitlines()
        is_same = len(wanted) == len(found) and all(map(is_as_shown, wanted, found))
        assert is_same, f"{code}\nshown:\n{shown}\nprinted:\n{printed}"
    check_against_truth(service, folder / "world.npz")


def check_against_truth(service: Any, world_path: Path) -> None:
    """Compare the newest attitude and the calibration with the simulator's truth by a way of our own."""
    headers = {"Authorization": f"Bearer {service.environment['SOO_KEY']}"}
    base_url = f"{service.url}/api/v1/spacecraft/yamal-202"
    with httpx.Client(headers=headers, timeout=10.0, trust_env=False) as client:
        row = client.get(f"{base_url}/attitude").json()
        calibration = client.get(f"{base_url}/calibrations/1").json()
    assert row["status"] == "ACQUIRED"
    world = np.load(world_path)
    assert np.datetime64(row["epoch"].removesuffix("Z"), "us").astype(np.int64) == world["epoch_us"][-1]
    for axis in ("roll", "pitch"):
        # 0.1 deg: the publication's own figure for roll and pitch beside the Earth sensor
        assert abs(row[f"{axis}_deg"] - float(world[f"{axis}_deg"][-1])) < 0.1, axis
    fitted = [[carrier["sensitivity_db_per_deg"][axis] for axis in AXES] for carrier in calibration["carriers"]]
    error = np.sqrt(np.mean((np.array(fitted) - world["sensitivity_db_per_deg"]) ** 2, axis=0))
    # the page on observability tells 0.16, 0.13, 0.13 dB/deg to two digits; yaw itself is 0.16
    np.testing.assert_allclose(error, [0.16, 0.13, 0.13], atol=0.03)
