"""Faults of pydantic in our words."""

from service.api.problems.validation_errors import MAX_FAULTS, faults_of, pointer_of


def fault(kind: str, *loc: str | int) -> dict:
    return {"type": kind, "loc": loc, "msg": "so"}


def test_pointers_escape_what_rfc_6901_asks_for():
    assert pointer_of(("a/b", "m~n", 0, "")) == "/a~1b/m~0n/0/"
    assert pointer_of(()) == ""


def test_codes_fold_into_stable_ones_and_ours_pass():
    kinds = ["missing", "extra_forbidden", "finite_number", "string_type", "less_than", "wheels.quantum"]
    assert [f.code for f in faults_of([fault(kind, "x") for kind in kinds])] == [
        "field.missing",
        "field.unknown",
        "value.not_finite",
        "value.type",
        "value.range",
        "wheels.quantum",
    ]


def test_a_sequence_is_not_called_short_because_its_elements_failed():
    assert [f.pointer for f in faults_of([fault("string_type", "rows", 0), fault("too_short", "rows")])] == ["/rows/0"]
    assert [f.pointer for f in faults_of([fault("too_short", "rows"), fault("missing", "row")])] == ["/rows", "/row"]


def test_an_answer_names_a_bounded_number_of_faults():
    assert len(faults_of([fault("missing", k) for k in range(1000)])) == MAX_FAULTS
