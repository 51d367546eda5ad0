"""The examples of the client's page, run one after another against a real service."""

import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

KEY = "a-key-for-tests-only"
PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "use-the-python-client.md"


def test_examples_do_what_they_claim(start_service):
    examples = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    assert len(examples) >= 5
    assert all("assert" in example for example in examples), "an example that claims nothing proves nothing"
    service = start_service()
    names = {"URL": service.url, "KEY": KEY}
    for example in examples:
        exec(compile(example, PAGE.name, "exec"), names)  # noqa: S102 - our own page
    assert service.end()[0] == 0
