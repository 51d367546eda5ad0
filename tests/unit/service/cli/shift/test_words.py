"""Words of the terminal are those of the console, and no text of others moves the terminal."""

import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.cli.shift.tables import MISSING, axes, clean, meaning, number, sentence, utc, words

ROW = {"downlink_fade_db": 2.5}
FIGURES = dict.fromkeys(("angle_deg", "limit_deg", "rate_deg_h", "hours_to_limit", "known_deg", "yaw_known_deg"))


def situation(code: str = "known", axis: str | None = None, **figures: float) -> dict[str, object]:
    known = {"known_deg": 0.04, "yaw_known_deg": 0.41} if code == "known" else {}
    return {"code": code, "severity": "normal", "axis": axis, **FIGURES, **known, **figures}


def reason(code: str, since: str | None = None) -> dict[str, object]:
    return {"code": code, "text": "its text", "next_step": "its step", "since": since}


def said(
    *reasons: dict[str, object], allowed: bool = False, found: dict[str, object] | None = None, **control: object
) -> str:
    state = "ARMED" if allowed else "INHIBITED"
    status = {
        "control": {"allowed": allowed, "state": state, "reasons": list(reasons), "situation": found or situation()},
        "newest_measurement": control.pop("newest", "t"),
    }
    return sentence(status, ROW, {"conditions": [], "open_commands": [], "unreported_commands": [], **control})


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
    assert said(allowed=True) == "roll, pitch known to 0.04 deg, yaw to 0.41 deg; torques may go"
    two = said(reason("stop", "2027-01-15T10:30:00Z"), reason("not_armed"))
    assert two.endswith(
        "no torque: an operator stopped control since 10:30 (and 1 more); find the cause, then reset control"
    )
    assert "but the sign of yaw is not proven" in said(reason("yaw_sign"), allowed=True)


def test_the_worst_is_said_first_with_its_figures() -> None:
    assert said(reason("not_armed"), found=situation("no_attitude")).startswith("no row has come yet;")
    growing = situation("beyond_and_growing", "pitch", angle_deg=2.56, limit_deg=0.4, rate_deg_h=0.31)
    text = (
        "pitch 2.56 deg is beyond its limit of 0.40 deg and grows by 0.31 deg/h; no torque: an operator stopped control"
    )
    assert said(reason("stop"), found=growing).startswith(text)
    soon = situation("towards_limit", "roll", angle_deg=-0.3, limit_deg=0.4, hours_to_limit=0.5)
    assert said(allowed=True, found=soon) == "roll -0.30 deg meets its limit of 0.40 deg in 0.50 h; torques may go"
    dark = said(reason("sigma_roll"), reason("redundancy"), found=situation("dark", "roll", angle_deg=4.95))
    assert dark == (
        "no carrier is on the air, roll was 4.95 deg; no torque; look at the receiving chain and the satellite first"
    )


def test_a_reason_has_the_value_of_its_condition() -> None:
    condition = {
        "code": "beyond_validity",
        "value": 0.417,
        "limit": 0.4,
        "unit": "deg",
        "since": "2027-01-15T10:16:00Z",
    }
    assert "range of the model, 0.42 of 0.40 deg since 10:16;" in said(
        reason("beyond_validity"), conditions=[condition]
    )
    assert "downlink fade 2.5 dB;" in said(reason("downlink_fade"))


def test_a_code_of_a_newer_service_is_said_in_the_words_of_the_service() -> None:
    assert said(reason("new_\x1b[1m_code")).endswith("no torque: its text; its step")
    assert meaning("states", "NEW\x1b[1m") == "NEW\N{REPLACEMENT CHARACTER}[1m"
    assert meaning("states", "NEW", "next") == ""
    assert words("views.links.state.NEW") == "NEW"


def test_values_are_not_read_as_words_again() -> None:
    found = words("views.now.sentence.forbidden", known="{next}", torque="{known}", reason="r", next="n")
    assert found == "{next}; {known}: r; n"


def test_what_waits_for_a_person_and_what_must_be_mended_first() -> None:
    assert "command 3, 4 waits for a second person" in said(reason("yaw_sign"), allowed=True, open_commands=[3, 4])
    assert "command 2 has no report" in said(allowed=True, unreported_commands=[2])
    assert "no torque" in said(reason("stop"), open_commands=[3])
    empty = said(reason("not_aligned"), reason("no_attitude"), newest=None)
    assert "no attitude has been computed yet (and 1 more); check the links" in empty
    assert said(reason("not_aligned"), found=situation("no_angles")).startswith("the attitude is not known;")


@pytest.mark.parametrize(("value", "shown"), [(None, MISSING), (-0.25, "-0.250"), (1.0, "1.000")])
def test_a_number_that_is_not_there_is_a_dash(value: float | None, shown: str) -> None:
    assert number(value) == shown


def test_instants_and_axes() -> None:
    assert utc("2027-01-15T10:30:00.000001Z") == "2027-01-15 10:30:00"
    assert utc(None) == MISSING
    assert axes({"yaw": None, "roll": 0.5, "pitch": -0.5}, 1, "deg") == f"Yaw {MISSING}, Roll 0.5, Pitch -0.5 deg"
