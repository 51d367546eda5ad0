"""Reference pages drawn from the tables that the code runs by: alarms, interlock and commands, acquisition states.

``python -m docs.reference_pages`` writes them; ``tests/docs`` holds pages and tables equal.
"""

from collections.abc import Sequence
from pathlib import Path

from service.frontend.acquisition import states as acquisition
from service.pipeline.alarms import states as alarms
from service.pipeline.alarms.alarm_engine import MOST_SIGMAS, RELEASE_S, TAIL_S
from service.pipeline.alarms.conditions import DEFAULT_SETS, NORMAL, condition_table
from service.pipeline.config import AlarmConfig, RobustConfig
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
from service.records.operations.alarms import ChangeKind, Process, Severity

_ALARMS = """# Alarms

Written by `python -m docs.reference_pages` from the tables that the code runs by
(`service/pipeline/alarms/conditions.py`, `states.py`); `tests/docs/test_reference.py` holds page and tables equal. How
to live with alarms: [handle alarms](../how-to/handle-alarms.md)."""

_CONDITIONS = """## Conditions

A value alarms after it has been beyond a limit for *on*, and is gone after it has been inside the outermost limit by
the deadband for *off*. Below, `>` alarms above the limit, `<` below it, `lasts` after that time. What is not known
neither alarms nor ends an alarm. An unacknowledged alarm is told again after *repeat*. *Latching* ones stay until they
are cleared."""

_SETS = """## Limit sets

The set `normal` holds always; others change single figures of it while they are in force: `eclipse` during that
operation, `manoeuvre` during `station_keeping`, `momentum_unloading` and `calibration_turn`. Where both change the same
figure, `manoeuvre` prevails. `carrier_work`, `gain_change`, `receive_chain_work` and `sun_outage` suppress the alarms
of the carriers that they name (of all where they name none). `GET .../alarm-limits/in-force` tells what holds."""

_CAUSES = f"""## Causes

An alarm that a standing one explains is a child of it: `state` suppressed, `cause` naming the other. It is stored,
listed inside its cause, not counted and told nobody. The size decides, within {MOST_SIGMAS:g} sigma of the carrier's
noise and of a tenth of what the cause does to its level; what is left beyond that is an alarm of its own.

| cause | explains | if |
|---|---|---|
| `downlink_fade`, `chain_level`, `attitude_angle` | `carrier_level`, `carrier_residual` | residual within sigma |
| the same | `carrier_c_n0` | without the cause the value would lie within its limit |
| the same | `methods_disagree`, `protection_level` | the cause is large enough |
| `downlink_fade` | `carrier_absent` | the carrier sank into the noise with the fade |
| `downlink_fade`, `chain_lost`, `attitude_lost` | `attitude_lost`, `protection_level` | always |
| `downlink_fade`, `chain_lost`, `chain_level` | `sensor_disagreement` | it is within the protection level |
| `chain_lost` | `carrier_absent` | always |
| `carrier_level` | `carrier_residual`, `carrier_c_n0` of this carrier | the same as above |
| `link_down` | `data_stale`, `link_warning`, `link_down` of what comes through it | always |

A child that its cause has left unexplained for {RELEASE_S:g} s, or for its *on* where that is longer, is told as an
alarm of its own; after the end of its cause it has {TAIL_S:g} s."""

_STATES = """## States

An alarm has a process state, and may lie under a cover that keeps it quiet; `state` tells the cover where there is one.
Clearing leads out of every state."""

_CHANGES = """## Changes

Every change is stored, told on the stream as an event `alarm`, and kept with the alarm (`GET /api/v1/alarms/{id}`).
Webhook and mail tell those that are marked, and never one of an alarm that is shelved or suppressed."""

_REPORTED = {
    ChangeKind.RAISED: "yes",
    ChangeKind.ESCALATED: "yes",
    ChangeKind.RETURNED: "yes",
    ChangeKind.REPEATED: "yes",
    ChangeKind.ACKNOWLEDGED: "webhook only",
    ChangeKind.SHELVED: "no",
    ChangeKind.UNSHELVED: "while unacknowledged",
    ChangeKind.SUPPRESSED: "no",
    ChangeKind.RELEASED: "while unacknowledged",
    ChangeKind.CLEARED: "webhook only",
}


def alarms_page() -> str:
    """Return the page of alarms."""
    conditions = condition_table(AlarmConfig(), RobustConfig())
    changes = [(kind.value, reported) for kind, reported in _REPORTED.items()]
    parts = [
        _ALARMS,
        _CONDITIONS,
        _limits_table(conditions),
        "### What each one says, and what to do",
        *(_words(condition) for condition in conditions.values()),
        _SETS,
        _sets_table(),
        _CAUSES,
        _STATES,
        "```mermaid\n" + alarm_diagram() + "\n```",
        *_alarm_tables(),
        _CHANGES,
        _table(("change", "told outside"), changes),
    ]
    return "\n\n".join(parts) + "\n"


def _limits_table(conditions: dict[str, alarms.AlarmCondition]) -> str:
    """Return the limits by default."""
    severities = [severity.word for severity in Severity]
    head = f"| condition | about | unit | | {' | '.join(severities)} | deadband | on, s | off, s | repeat, s |"
    rows = [head, "|---" * (8 + len(severities)) + "|"]
    for condition in conditions.values():
        limits = condition.limits
        sign = {"above": ">", "below": "<", "lasting": "lasts"}[condition.kind.value]
        figures = [_figure(limit) for limit in limits.thresholds]
        figures += [_figure(each) for each in (limits.deadband, limits.on_s, limits.off_s, limits.repeat_s)]
        name = f"`{condition.name}`" + (" latching" if limits.latching else "")
        rows.append(f"| {name} | {condition.thing} | {condition.unit} | {sign} | {' | '.join(figures)} |")
    return "\n".join(rows)


def _words(condition: alarms.AlarmCondition) -> str:
    """Return text, origin and next step of a condition."""
    says = condition.says.format(thing="*name*", value="*value*")
    says = f"* **`{condition.name}`**: {says}; checked at {condition.origin.value}."
    return _wrapped(f"{says} What to do: {condition.next_step}.")


def _wrapped(text: str, width: int = 118) -> str:
    """Return a text in lines, those after the first one indented."""
    lines, line = [], ""
    for word in text.split():
        if len(line) + len(word) + 1 > width:
            lines.append(line)
            line = f"  {word}"
        else:
            line = f"{line} {word}" if line else word
    return "\n".join([*lines, line])


def _sets_table() -> str:
    """Return the default changes by the limit sets."""
    rows = ["| set | condition | changes |", "|---|---|---|"]
    for name, statements in DEFAULT_SETS.items():
        for condition, statement in statements.items():
            changes = ", ".join(
                f"{field} {str(value).lower() if isinstance(value, bool) else _figure(value)}"
                for field, value in statement.items()
            )
            rows.append(f"| {name} | `{condition}` | {changes} |")
        if not statements and name != NORMAL:
            rows.append(f"| {name} | - | - |")
    return "\n".join(rows)


def _figure(value: float | None) -> str:
    """Return a figure, a dash where there is none."""
    return "-" if value is None else f"{value:g}"


def alarm_diagram() -> str:
    """Return the tables of alarms as a Mermaid state diagram; what stays in its state is left out."""
    lines = ["stateDiagram-v2", "    [*] --> normal"]
    for state, row in alarms.PROCESS.items():
        lines += _arrows(state.value, {event.name: target.value for event, target in row.items()})
    for state, row in alarms.PROCESS.items():
        latched = {event: alarms.next_process(state, event, is_latching=True) for event in row}
        names = ", ".join(event.name for event, target in latched.items() if target is not row[event])
        lines += [f"    {state.value} --> {Process.LATCHED.value}: {names} (where it latches)"] if names else []
    lines.append("    state cover {")
    for cover, covered in alarms.COVERS.items():
        arrows = _arrows(cover.value, {event.name: target.value for event, target in covered.items()})
        lines += [f"    {line}" for line in arrows]
    return "\n".join([*lines, "    }"])


def _arrows(state: str, targets: dict[str, str]) -> list[str]:
    """Return the arrows that leave a state."""
    leaving: dict[str, list[str]] = {}
    for event, target in targets.items():
        if target != state:
            leaving.setdefault(target, []).append(event)
    return [f"    {state} --> {target}: {', '.join(events)}" for target, events in leaving.items()]


def _alarm_tables() -> tuple[str, ...]:
    """Return both tables of alarms, and what each event means."""
    process = [(state.value, *(target.value for target in row.values())) for state, row in alarms.PROCESS.items()]
    covers = [(cover.value, *(target.value for target in row.values())) for cover, row in alarms.COVERS.items()]
    return (
        _table(("state", *(event.name for event in alarms.AlarmEvent)), process),
        _table(("cover", *(event.name for event in alarms.CoverEvent)), covers),
        _table(("event", "meaning"), [(event.name, meaning) for event, meaning in alarms.MEANINGS.items()]),
    )


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


def interlock_page() -> str:
    """Return the page of interlock and commands."""
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


def acquisition_diagram() -> str:
    """Return the table as a Mermaid state diagram; what stays in its state is left out, but for measuring."""
    lines = ["stateDiagram-v2", "    [*] --> CONNECT"]
    measuring = (acquisition.AcquisitionState.MEASURE, acquisition.AcquisitionEvent.OK)
    for state, row in acquisition.TRANSITIONS.items():
        targets: dict[acquisition.AcquisitionState, list[str]] = {}
        for event, target in row.items():
            if target is not state or (state, event) == measuring:
                targets.setdefault(target, []).append(event.name)
        lines += [f"    {state.name} --> {target.name}: {', '.join(events)}" for target, events in targets.items()]
    return "\n".join(lines)


def acquisition_page() -> str:
    """Return the page of acquisition states."""
    states = [
        (state.name, *(acquisition.TRANSITIONS[state][event].name for event in acquisition.AcquisitionEvent))
        for state in acquisition.AcquisitionState
    ]
    parts = [
        "# States of an acquisition",
        "Written by `python -m docs.reference_pages` from the table that the code runs by,\n"
        "`service/frontend/acquisition/states.py`. `tests/docs/test_how_to.py` holds page and table equal.",
        "```mermaid\n" + acquisition_diagram() + "\n```",
        _table(("state", "action"), [(state.name, action) for state, action in acquisition.ACTIONS.items()]),
        _table(("state", *(event.name for event in acquisition.AcquisitionEvent)), states),
        _table(("event", "meaning"), [(event.name, meaning) for event, meaning in acquisition.MEANINGS.items()]),
        "A stop is looked at between actions: the cycle in hand is finished and its row handed over. A thread that\n"
        "hangs beyond every bound of its action is shown as STUCK in the report of the link, and its line is cut.",
    ]
    return "\n\n".join(parts) + "\n"


def main() -> None:
    """Write the pages."""
    folder = Path(__file__).parent / "reference"
    pages = {"alarms": alarms_page, "interlock": interlock_page, "acquisition-states": acquisition_page}
    for name, page in pages.items():
        (folder / f"{name}.md").write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
