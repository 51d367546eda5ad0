"""The page of interlock and commands is the tables that the code runs by."""

from pathlib import Path

from service.pipeline.control.release.command_states import COMMAND_TRANSITIONS, CommandState, CommandTransition
from service.pipeline.control.release.interlock_conditions import Condition
from service.pipeline.control.release.interlock_states import REFUSALS, TRANSITIONS, Guard, State, Trigger
from service.pipeline.control.release.reference_page import command_diagram, interlock_diagram, reference_page

ROOT = Path(__file__).resolve().parents[2]


def test_page_is_the_tables() -> None:
    assert (ROOT / "docs/reference/interlock.md").read_text() == reference_page()


def test_page_names_everything() -> None:
    page = reference_page()
    for name in (*State, *Trigger, *CommandState, *CommandTransition):
        assert f"| `{name.name}` |" in page
    assert all(f"| `{condition.word}` |" in page for condition in Condition)
    assert all(len(line) <= 120 for line in page.splitlines())


def test_diagrams_draw_every_change() -> None:
    for row in TRANSITIONS:
        if row.source is not row.target:
            lines = interlock_diagram().splitlines()
            (line,) = [each for each in lines if f" {row.source.name} --> {row.target.name}:" in each]
            assert row.trigger.name in line
    for life, turns in COMMAND_TRANSITIONS.items():
        for turn, target in turns.items():
            assert f"    {life.name} --> {target.name}: {turn.name}" in command_diagram().splitlines()


def test_every_order_that_may_fail_has_a_code_and_every_guard_a_row() -> None:
    assert set(REFUSALS) == {Trigger.ARM, Trigger.ENGAGE, Trigger.DISENGAGE, Trigger.RESET}
    assert {row.guard for row in TRANSITIONS} == set(Guard)
