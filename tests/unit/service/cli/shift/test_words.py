"""Words of the terminal are those of the console, and no text of others moves the terminal."""

import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.cli.shift.words import MISSING, axes, clean, meaning, number, ranked, sentence, utc, words

ROW = {"status": "ACQUIRED", "sigma_deg": {"yaw": 0.1, "roll": 0.01, "pitch": 0.02}, "downlink_fade_db": 2.5}


def reason(code: str, since: str | None = None) -> dict[str, object]:
    return {"code": code, "text": "its text", "next_step": "its step", "since": since}


def said(*reasons: dict[str, object], allowed: bool = False, row: dict[str, object] = ROW, conditions=()) -> str:
    return sentence({"allowed": allowed, "reasons": list(reasons)}, row, list(conditions))


@given(text=st.text())
def test_no_text_holds_what_a_terminal_executes(text: str) -> None:
    shown = clean(text)
    assert not {unicodedata.category(each) for each in shown} & {"Cc", "Cf", "Cs"}
    assert clean(shown) == shown
    assert len(shown) <= len(text)


@given(text=st.text(st.characters(categories=("L", "N", "P")), min_size=1))
def test_a_harmless_word_stays_as_it_is(text: str) -> None:
    assert clean(text) == text


def test_the_sentence_says_what_is_known_the_first_reason_and_its_next_step() -> None:
    assert said(allowed=True) == "roll, pitch known to 0.04 deg; torques may go"
    two = said(reason("not_armed"), reason("stop", "2027-01-15T10:30:00Z"))
    assert two.endswith(
        "no torque: an operator stopped control since 10:30 (and 1 more); find the cause, then reset control"
    )
    assert "but the sign of yaw is not proven" in said(reason("yaw_sign"), allowed=True)
    assert said(row={**ROW, "status": "NOT_RECEIVED"}, allowed=True).startswith("no row has come yet;")


def test_a_reason_has_the_value_of_its_condition() -> None:
    condition = {"code": "beyond_validity", "value": 0.417, "unit": "deg", "since": "2027-01-15T10:16:00Z"}
    assert "range of the model 0.42 deg since 10:16;" in said(reason("beyond_validity"), conditions=[condition])
    assert "downlink fade 2.5 dB;" in said(reason("downlink_fade"))


def test_a_code_of_a_newer_service_is_said_in_the_words_of_the_service() -> None:
    assert said(reason("new_\x1b[1m_code")).endswith("no torque: its text; its step")
    assert meaning("states", "NEW\x1b[1m") == "NEW\N{REPLACEMENT CHARACTER}[1m"
    assert meaning("states", "NEW", "next") == ""
    assert words("views.links.state.NEW") == "NEW"


def test_values_are_not_read_as_words_again() -> None:
    assert words("views.now.sentence.forbidden", known="{next}", reason="r", next="n") == "{next}; no torque: r; n"


def test_the_reason_to_act_on_comes_first() -> None:
    order = [each["code"] for each in ranked([reason(code) for code in ("not_armed", "yaw_sign", "stop", "fade")])]
    assert order == ["stop", "fade", "yaw_sign", "not_armed"]


@pytest.mark.parametrize(("value", "shown"), [(None, MISSING), (-0.25, "-0.250"), (1.0, "1.000")])
def test_a_number_that_is_not_there_is_a_dash(value: float | None, shown: str) -> None:
    assert number(value) == shown


def test_instants_and_axes() -> None:
    assert utc("2027-01-15T10:30:00.000001Z") == "2027-01-15 10:30:00"
    assert utc(None) == MISSING
    assert axes({"yaw": None, "roll": 0.5, "pitch": -0.5}, 1, "deg") == f"Yaw {MISSING}, Roll 0.5, Pitch -0.5 deg"
