"""The page of the simulator's ports names every option and every fault, and nothing else."""

import argparse
import re
from pathlib import Path

from analyzer_sim.__main__ import build_parser
from analyzer_sim.serving import FAULT_NAMES

PAGE = (Path(__file__).resolve().parents[2] / "docs/reference/simulated-ports.md").read_text()


def test_options_are_those_of_the_command_line() -> None:
    actions = [action for action in build_parser()._actions if isinstance(action, argparse._SubParsersAction)]
    known = {name for action in actions[0].choices["serve"]._actions for name in action.option_strings}
    rows = re.findall(r"^\| (`--.*?) \|", PAGE, re.MULTILINE)
    assert set(re.findall(r"--[a-z-]+", " ".join(rows))) == known - {"-h", "--help"}


def test_faults_are_those_that_can_be_armed() -> None:
    rows = re.findall(r"^\| (`[a-z_, `]+`) \|", PAGE.partition("## Faults")[2], re.MULTILINE)
    assert sorted(re.findall(r"`([a-z_]+)`", " ".join(rows))) == sorted(FAULT_NAMES)
