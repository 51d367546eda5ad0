"""The page of the reference about interlock and commands, drawn from the tables that the code runs by."""

from collections.abc import Sequence

from service.pipeline.control.release.command_states import (
    COMMAND_TRANSITIONS,
    MEANINGS,
    TRANSITIONS,
    CommandTransition,
    Guard,
    State,
    Trigger,
)
from service.pipeline.control.release.control_verdict import OTHER_REASONS
from service.pipeline.control.release.interlock_conditions import MEASURES, Condition, Consequence, ReleaseSettings


def interlock_diagram() -> str:
    """Return the states of the interlock as a Mermaid state diagram; what stays in its state is left out."""
    lines = ["stateDiagram-v2", f"    [*] --> {State.INHIBITED.name}"]
    arrows: dict[tuple[State, State], list[str]] = {}
    for row in TRANSITIONS:
        if row.source is not row.target:
            guard = f" [{row.guard.value}]" if row.guard is not Guard.ALWAYS else ""
            arrows.setdefault((row.source, row.target), []).append(row.trigger.name + guard)
    lines += [f"    {a.name} --> {b.name}: {', '.join(names)}" for (a, b), names in arrows.items()]
    return "\n".join(lines)


def command_diagram() -> str:
    """Return the states of a command as a Mermaid state diagram."""
    lines = ["stateDiagram-v2", f"    [*] --> {next(iter(MEANINGS))}"]
    for state, row in COMMAND_TRANSITIONS.items():
        lines += [f"    {state} --> {target}: {transition.name}" for transition, target in row.items()]
        lines += [] if row else [f"    {state} --> [*]"]
    return "\n".join(lines)


def reference_page() -> str:
    """Return the page (Markdown)."""
    parts = [
        "# Interlock and commands",
        "Drawn from the tables that the code runs by, `service/pipeline/control/release`.\n"
        "`tests/docs/test_reference.py` holds page and tables equal,\n"
        "`tests/property/test_release_interlock.py` that no sequence of events yields a torque while a reason stands.\n"
        "Every figure is the default of a setting. The interlock stops control, never estimation.",
        "## States",
        "```mermaid\n" + interlock_diagram() + "\n```",
        _table(("state", "meaning"), [(f"`{state.name}`", state.value) for state in State]),
        _table(("trigger", "when"), [(f"`{trigger.name}`", trigger.value) for trigger in Trigger]),
        "Of several rows of one state and trigger the first holds whose guard does. A trigger without a row is\n"
        "refused where a person ordered it, and means nothing where time brought it about.",
        _table(
            ("state", "trigger", "guard", "next state"),
            [(row.source.name, row.trigger.name, row.guard.value or "-", row.target.name) for row in TRANSITIONS],
        ),
        "## Conditions",
        *(_conditions_of(consequence) for consequence in Consequence),
        "What is not known counts as bad; only a momentum that no telemetry tells is passed over. A trip takes arming\n"
        "and authorisation away: after the reset come ten good minutes, and an operator arms again. In release\n"
        "`automatic` nobody arms: torques are withheld from the trip until these ten good minutes are over.\n"
        "There the row alone says whether yaw is controlled; conditions of yaw are named while it is not.",
        *_in_the_interface(),
        "## States of a command",
        "```mermaid\n" + command_diagram() + "\n```",
        _table(("state", "meaning"), [(f"`{state}`", meaning) for state, meaning in MEANINGS.items()]),
        _table(("transition", "when"), [(f"`{each.name}`", each.value) for each in CommandTransition]),
        "A command released by standing authorisation goes from PREPARED to RELEASED in one step. Every released\n"
        "command is uncertainty of the filter, with its whole effect, until its report; one at a time. In release\n"
        "`automatic` computed commands count as applied and have no state here: one beyond the envelope trips.",
    ]
    return "\n\n".join(parts) + "\n"


def _in_the_interface() -> tuple[str, ...]:
    """Return the section on the conditions as the interface answers them."""
    return (
        "## Conditions in the interface",
        "`conditions` of `GET .../control` lists these conditions (an alarm is none), [those of a row and its\n"
        "command](data-levels.md) and those of arming, with `met`, `value`, `limit`, `bound`, `unit` and `since`.\n"
        "Those that are not met are the reasons of `control`; control is allowed when all are met that withhold more\n"
        "than yaw. `met` is null where nothing is known to judge by, or another reason comes first. `good_minutes`\n"
        "tells how much of the ten good minutes has passed.",
        _table(
            ("condition", "value", "unit", "limit is the"),
            [
                (f"`{each.word}`", measure.name, measure.unit or "-", "least" if measure.is_least else "greatest")
                for each, measure in MEASURES.items()
            ],
        ),
        "Of a row: `fade` and `downlink_fade` in dB without a limit, `beyond_validity` and `protection_level` in deg,\n"
        "the greater of roll and pitch. `good_minutes` counts seconds.",
        _table(
            ("condition of arming and of the newest answer", "stands when"),
            [(f"`{code}`", text.format(**ReleaseSettings().figures)) for code, text in OTHER_REASONS.items()],
        ),
    )


def _conditions_of(consequence: Consequence) -> str:
    """Return a consequence and the conditions that have it."""
    rows = [(f"`{each.word}`", each.text(ReleaseSettings())) for each in Condition if each.consequence is consequence]
    return f"{consequence.value}:\n\n" + _table(("condition", "stands when"), rows)


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """Return a Markdown table."""
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([f"| {' | '.join(head)} |", "|" + "---|" * len(head), *lines])
