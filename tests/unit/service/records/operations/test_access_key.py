"""Names of keys: what is kept of them, and what nobody may be called."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.records.operations.access_key import is_plain_name, plain_name


@pytest.mark.parametrize(
    ("given", "kept"),
    [
        ("  Olga  B. ", "Olga B."),
        ("Olga\u00a0B.", "Olga B."),
        ("\uff2flga", "Olga"),
        ("Ольга", "Ольга"),
        ("Zoe\u0308", "Zoë"),
        ("anonymous 2", "anonymous 2"),
    ],
)
def test_names_are_kept_in_one_form(given, kept):
    assert plain_name(given) == kept
    assert is_plain_name(kept)
    assert is_plain_name(given) == (given == kept)


@pytest.mark.parametrize(
    "name",
    [
        *(
            f"Ol{letter}ga"
            for letter in "\u200b\u200e\u2066\u00ad\ufeff\x07\n\u2028\u2029\u1680\u3164\u2800\ufe0f\U000e0041\ue000"
        ),
        *("bootstrap", " BootStrap ", "anonymous", "ＡＮＯＮＹＭＯＵＳ", "Service"),
        *("", "   ", "x" * 65, "\ufdfa" * 4),
    ],
)
def test_names_that_nobody_sees_or_that_others_have_are_refused(name):
    with pytest.raises(ValueError, match=r"cannot be seen|calls others so|1 to 64"):
        plain_name(name)


@given(st.text(max_size=20))
def test_a_name_that_is_kept_is_kept_again(text):
    try:
        name = plain_name(text)
    except ValueError:
        return
    assert plain_name(name) == name
