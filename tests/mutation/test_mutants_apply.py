"""The sixty mutants still apply: each function exists once, and its text stands in it once."""

import ast

import pytest
from mutants import mutated
from sixty_mutants import ARCHIVE, CORE, EDGES, MUTANTS, PIPELINE, RELEASE


def test_mutants_spread_over_the_subjects() -> None:
    assert [len(each) for each in (CORE, PIPELINE, RELEASE, ARCHIVE, EDGES)] == [20, 15, 10, 8, 7]
    assert len(set(MUTANTS)) == 60


@pytest.mark.parametrize(
    ("number", "mutant"), list(enumerate(MUTANTS, 1)), ids=lambda value: getattr(value, "name", None)
)
def test_mutant_applies(number: int, mutant: object) -> None:
    try:
        path, source = mutated(mutant)
    except LookupError as error:
        pytest.fail(f"mutant {number} does not apply: {error}; repair it in tests/mutation/sixty_mutants.py")
    assert ast.dump(ast.parse(source)) != ast.dump(ast.parse(path.read_text()))
