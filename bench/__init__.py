"""Benchmarks: ratios of two things measured in turn."""

import sys
from pathlib import Path

# what tests share imports its neighbours by name, as pytest's pythonpath lets it
sys.path.append(str(Path(__file__).resolve().parent.parent / "tests" / "fakes"))
