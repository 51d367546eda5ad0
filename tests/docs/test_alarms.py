"""The pages on alarms say what the code does."""

from pathlib import Path

from service.pipeline.alarms.conditions import condition_table
from service.pipeline.alarms.reference_page import reference_page
from service.pipeline.alarms.states import diagram
from service.pipeline.config import AlarmConfig, RobustConfig
from service.records.operations.alarm import ChangeKind

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "reference" / "alarms.md"


def test_the_page_is_drawn_from_the_tables() -> None:
    assert PAGE.read_text() == reference_page(), (
        "run: python -m service.pipeline.alarms.reference_page > docs/reference/alarms.md"
    )
    assert diagram() in PAGE.read_text()


def test_every_condition_and_every_change_stands_on_the_page() -> None:
    text = PAGE.read_text()
    for name in condition_table(AlarmConfig(), RobustConfig()):
        assert text.count(f"`{name}`") >= 2, name
    for kind in ChangeKind:
        assert f"| {kind.value} |" in text
