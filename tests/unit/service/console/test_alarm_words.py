"""Words of the view of alarms: those of the code's tables, no more and no fewer."""

import json
from pathlib import Path
from typing import get_args

import pytest

from service.api.schemas.alarms import SetName
from service.records.operations.alarm import ChangeKind, Cover, Process

WORDS = Path(__file__).parents[4] / "service/console/static/words"
STATES = {each.value for each in Process} | {each.value for each in Cover if each is not Cover.NONE}


@pytest.mark.parametrize("language", ["en", "ru"])
def test_every_state_change_and_limit_set_has_words(language):
    table = json.loads((WORDS / f"{language}.json").read_text())
    view = table["views"]["alarms"]
    assert set(view["state"]) == STATES
    assert set(view["change"]) == {each.value for each in ChangeKind}
    assert set(view["set"]) == set(get_args(SetName))
