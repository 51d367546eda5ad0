"""Benchmarks: ratios of two things measured in turn."""

import sys
from pathlib import Path

# what tests share imports its neighbours by name, as pytest's pythonpath lets it
FAKES = Path(__file__).resolve().parent.parent / "tests" / "fakes"
sys.path.extend(str(FAKES / room) for room in ("worlds", "drivers", "ports"))
