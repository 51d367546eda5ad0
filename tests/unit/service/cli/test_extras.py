"""A command whose extra is not installed names the extra."""

import subprocess
import sys

import pytest

HIDDEN = """
import sys
sys.modules[{name!r}] = None
sys.argv = ["soo", *{words!r}]
from service.__main__ import main
main()
"""
TASK = '{"id": "t", "sweeps": [], "carriers": []}'


@pytest.mark.parametrize(
    ("name", "words", "extra"),
    [
        ("pyvisa", ["acquire", "--task", "task.json", "--spacecraft", "sc"], "station"),
        ("pyvisa", ["demo", "--exit"], "station"),
        ("distributed", ["study", "estimation", "--scheduler", "tcp://127.0.0.1:1"], "cluster"),
        ("distributed", ["study", "closed-loop", "--scheduler", "tcp://127.0.0.1:1"], "cluster"),
        ("matplotlib", ["study", "limit-cycles", "--figures", "drawn"], "study"),
    ],
)
def test_a_missing_package_is_told_by_its_extra(name: str, words: list[str], extra: str, tmp_path) -> None:
    (tmp_path / "task.json").write_text(TASK)
    code = HIDDEN.format(name=name, words=words)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, timeout=300, check=False
    )
    assert done.returncode == 2, done.stderr
    assert f"install the extra {extra}: pip install 'soo[{extra}]'" in done.stderr
