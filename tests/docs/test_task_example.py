"""The measurement task of the how-to can be loaded and planned, and every field that it explains exists."""

import re
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from service.frontend.measurement_task import MeasurementTask, parse_task
from service.frontend.tasks.task_plan import plan_task

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/how-to/connect-an-analyzer.md").read_text()


def example() -> bytes:
    """Return the task of the page, its first JSON block."""
    block, *_ = re.findall(r"^```json\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    return bytes(block, "utf-8")


def test_example_is_a_task_without_faults() -> None:
    task, _ = parse_task(example())
    plan = plan_task(task)
    assert plan.findings == ()
    # more than the figure of a sweep would be a task too weak to show; below it nothing is claimed
    assert all(0.0 < sigma_db < 0.2 for sigma_db in plan.sigma_db.values()), plan.sigma_db


def names_of(model: type[BaseModel]) -> set[str]:
    """Return the names of all fields of a model and of the models inside."""
    names = set(model.model_fields)
    for field in model.model_fields.values():
        for part in parts_of(field.annotation):
            names |= names_of(part)
    return names


def parts_of(annotation: Any) -> list[type[BaseModel]]:
    """Return the models that an annotation names."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [part for inner in getattr(annotation, "__args__", ()) for part in parts_of(inner)]


def test_table_explains_fields_that_exist() -> None:
    rows = re.findall(r"^\| (`[a-z].*?) \| [^|]* \| [^|]* \|$", PAGE, re.MULTILINE)
    named = {name for row in rows for path in re.findall(r"`([^`]+)`", row) for name in re.split(r"\W+", path) if name}
    assert len(named) > 25, "the table was not found"
    assert named - names_of(MeasurementTask) == set()
