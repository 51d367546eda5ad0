"""Sentences on what pydantic refused: every kind has one, and none is the library's."""

import re
from typing import Annotated, Literal, get_args

import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core.core_schema import ErrorType

from service.records.field_faults import fault_sentence, faults_text

#: beginnings and words that are pydantic's
LIBRARY = re.compile(
    r"Input should|should have|should be|Value error|Field required|not permitted|valid \w+,|unable to"
)
#: what the sentences name; the value that was sent is not among it
CONTEXT = {
    "min_length": 1,
    "max_length": 2,
    "pattern": "a+",
    "expected": "'a' or 'b'",
    "expected_tags": "'a' or 'b'",
    "discriminator": "'kind'",
    "gt": 0,
    "ge": 0,
    "lt": 1,
    "le": 1,
    "multiple_of": 2,
    "error": "expected value at line 1 column 1",
}


class Document(BaseModel):
    """Document with one field of each form."""

    model_config = ConfigDict(extra="forbid")
    count: Annotated[int, Field(gt=0)]
    pair: Annotated[tuple[float, ...], Field(max_length=2)]
    name: Annotated[str, Field(pattern="^[a-z]+$", max_length=4)]
    word: Literal["a", "b"]


@pytest.mark.parametrize("kind", get_args(ErrorType))
def test_every_kind_has_a_sentence_of_our_own(kind: str) -> None:
    sentence = fault_sentence({"type": kind, "ctx": CONTEXT, "msg": "Input should be something"})
    assert sentence
    assert "{" not in sentence
    assert not LIBRARY.search(sentence), sentence


def test_sentences_say_what_a_field_must_be_and_not_what_was_sent() -> None:
    sent = {"count": -7777, "pair": [1, 2, 3], "name": "SECRET", "word": "c", "more": 1}
    with pytest.raises(ValidationError) as raised:
        Document.model_validate(sent)
    assert faults_text(raised.value.errors()) == (
        "count: must be greater than 0; pair: must have at most 2 entries; name: must have at most 4 characters; "
        "word: must be 'a' or 'b'; more: unknown field; check its spelling or leave it out"
    )


def test_a_sentence_of_our_own_validator_stays() -> None:
    assert fault_sentence({"type": "epoch.malformed", "msg": "not RFC 3339"}) == "not RFC 3339"
    assert fault_sentence({"type": "value_error", "ctx": {"error": ValueError("start is not before stop")}}) == (
        "start is not before stop"
    )


def test_a_fault_of_the_whole_document_names_it() -> None:
    with pytest.raises(ValidationError) as raised:
        Document.model_validate_json("[")
    assert faults_text(raised.value.errors(), "task").startswith("task: is not JSON: ")
