"""The page of the reference on alarms, drawn from the tables that the code runs by.

``python -m service.pipeline.alarms.reference_page > docs/reference/alarms.md`` writes it.
"""

import sys

from service.pipeline.alarms.alarm_engine import MOST_SIGMAS, RELEASE_S, TAIL_S
from service.pipeline.alarms.conditions import DEFAULT_SETS, NORMAL, condition_table
from service.pipeline.alarms.states import AlarmCondition, diagram, tables
from service.pipeline.config import AlarmConfig, RobustConfig
from service.records.operations.alarms import ChangeKind, Severity

_HEAD = """# Alarms

Written by `python -m service.pipeline.alarms.reference_page` from the tables that the code runs by
(`service/pipeline/alarms/conditions.py`, `limit_sets.py`, `states.py`); `tests/docs/test_reference.py` holds page
and tables equal. How to live with alarms: [handle alarms](../how-to/handle-alarms.md)."""

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


def reference_page() -> str:
    """Return the page (Markdown)."""
    conditions = condition_table(AlarmConfig(), RobustConfig())
    changes = [f"| {kind.value} | {reported} |" for kind, reported in _REPORTED.items()]
    parts = [
        _HEAD,
        _CONDITIONS,
        _limits_table(conditions),
        "### What each one says, and what to do",
        *(_words(condition) for condition in conditions.values()),
        _SETS,
        _sets_table(),
        _CAUSES,
        _STATES,
        "```mermaid\n" + diagram() + "\n```",
        tables(),
        _CHANGES,
        "\n".join(["| change | told outside |", "|---|---|", *changes]),
    ]
    return "\n\n".join(parts) + "\n"


def _limits_table(conditions: dict[str, AlarmCondition]) -> str:
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


def _words(condition: AlarmCondition) -> str:
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


if __name__ == "__main__":
    sys.stdout.write(reference_page())
