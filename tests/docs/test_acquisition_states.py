"""The page of states is the table that the code runs by."""

from pathlib import Path

from service.frontend.acquisition.states import ACTIONS, MEANINGS, TRANSITIONS, Event, State, diagram, reference_page

ROOT = Path(__file__).resolve().parents[2]


def test_page_is_the_table() -> None:
    assert (ROOT / "docs/reference/acquisition-states.md").read_text() == reference_page()


def test_page_names_every_state_and_event_and_draws_every_change() -> None:
    page = reference_page()
    assert set(ACTIONS) == set(State)
    assert set(MEANINGS) == set(Event)
    assert all(f"| {state.name} |" in page for state in State)
    for state, row in TRANSITIONS.items():
        for event, target in row.items():
            if target is not state:
                (line,) = [each for each in diagram().splitlines() if f"{state.name} --> {target.name}:" in each]
                assert event.name in line
