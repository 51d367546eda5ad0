"""Diagnoses: what an examination of an archive found, in words for the person who has to act."""

from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "warning", "fault"]


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """One thing that was looked at."""

    #: what was looked at, one word
    check: str
    state: State
    #: what is there
    detail: str
    #: what to do; empty where nothing has to be done
    advice: str = ""


def worst(diagnoses: list[Diagnosis]) -> State:
    """Return the worst state among diagnoses.

    Examples
    --------
    >>> worst([Diagnosis("disk", "warning", "little room"), Diagnosis("clock", "ok", "agrees")])
    'warning'
    """
    states = {diagnosis.state for diagnosis in diagnoses}
    if "fault" in states:
        return "fault"
    return "warning" if "warning" in states else "ok"
