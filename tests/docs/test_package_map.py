"""The package map is that of the imports."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_page_and_pictures_are_current(tmp_path: Path) -> None:
    for folder in ("explanations", "images"):
        (tmp_path / folder).mkdir()
    subprocess.run([sys.executable, "-m", "docs.package_map", str(tmp_path)], cwd=ROOT, check=True, timeout=300)
    drawn = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*.*"))
    assert len(drawn) == 5
    for path in drawn:
        assert (ROOT / "docs" / path).read_text() == (tmp_path / path).read_text(), f"{path}: run make map"
