"""Commands that read the state of a spacecraft, and orders to its alarms and shift log."""

from itertools import chain
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.command_group import end
from service.cli.operation.connection import JsonOption, SpacecraftOption, on_service
from service.cli.shift import tables
from service.client.documents import Json
from service.records.epoch import US_PER_S, format_epoch, parse_epoch

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.console import RenderableType

    from service.client.service_client import ServiceClient


Comment = Annotated[str, typer.Option(help="Comment for the shift log.")]
AlarmId = Annotated[int, typer.Argument(help="Id of the alarm, as `soo alarms` lists it.", min=1)]


@on_service
def ack(client: "ServiceClient", alarm: AlarmId, comment: Comment = "", as_json: JsonOption = False) -> None:
    """Acknowledge an alarm; no further notice unless it becomes worse or comes back."""
    found = client.request("POST", f"/alarms/{alarm}:acknowledge", {"comment": comment})
    tables.show(found, lambda: [tables.alarm_line(found)], as_json=as_json)


@on_service
def shelve(
    client: "ServiceClient",
    alarm: AlarmId,
    spacecraft: SpacecraftOption,
    hours: Annotated[float, typer.Option(help="For how long, h.", min=0.01, max=24.0)] = 1.0,
    comment: Comment = "",
    as_json: JsonOption = False,
) -> None:
    """Keep an alarm quiet for some hours of the spacecraft's clock."""
    now = client.status(spacecraft)["now"]
    if now is None:
        end(f"{spacecraft} has no present before its first row, so nothing can be shelved until an instant", 1)
    until = format_epoch(parse_epoch(now) + round(hours * 3600 * US_PER_S))
    found = client.request("POST", f"/alarms/{alarm}:shelve", {"until": until, "comment": comment})
    tables.show(found, lambda: [f"shelved until {tables.utc(until)} UTC", tables.alarm_line(found)], as_json=as_json)


@on_service
def note(
    client: "ServiceClient",
    text: Annotated[str, typer.Argument(help="Text of the note.")],
    spacecraft: SpacecraftOption,
    corrects: Annotated[int | None, typer.Option(help="Id of the note that this one corrects.", min=1)] = None,
    as_json: JsonOption = False,
) -> None:
    """Write a note into the shift log."""
    body = {"text": text, "spacecraft_id": spacecraft, "corrects": corrects}
    found = client.request("POST", "/notes", body)
    tables.show(
        found,
        lambda: [f"note {found['id']} of {tables.utc(found['epoch'])} UTC: {tables.clean(found['text'])}"],
        as_json=as_json,
    )


EXIT_ATTENTION, EXIT_TRIPPED = 3, 4


@on_service
def status(client: "ServiceClient", spacecraft: SpacecraftOption, as_json: JsonOption = False) -> None:
    """Say whether torques may go, why not, and what to do next."""
    found = Json(client.status(spacecraft))
    row, control = (Json(client.attitude(spacecraft)), Json(client.control(spacecraft))) if not as_json else ({}, {})
    verdict = found["control"]

    def parts() -> "Iterator[RenderableType]":
        yield f"{spacecraft}: {tables.sentence(found, row, control)}"
        yield f"{tables.words('views.control.title')}: {tables.meaning('states', verdict['state'])}"
        if verdict["reasons"]:
            yield tables.reasons_table(verdict["reasons"])
        newest, now = tables.utc(found["newest_attitude"]), tables.utc(found["now"])
        yield f"newest row {newest}, now {now} UTC; rows pending: {found['pending']}"
        if found["methods_disagree"]:
            disagreement = tables.meaning("alarms", "methods_disagree")
            yield f"{disagreement}: {tables.meaning('alarms', 'methods_disagree', 'next')}"
        for each in found["advice"]:
            advice = tables.meaning("advice", each["code"], default=each["text"])
            yield f"{advice}: {tables.meaning('advice', each['code'], 'next')}"
        yield from map(tables.link_line, found["links"])

    tables.show(found, parts, as_json=as_json)
    if not verdict["allowed"]:
        raise typer.Exit(EXIT_TRIPPED if verdict["state"] == "TRIPPED" else EXIT_ATTENTION)


@on_service
def attitude(client: "ServiceClient", spacecraft: SpacecraftOption, as_json: JsonOption = False) -> None:
    """Say where the spacecraft points, how sure that is, and what both methods say."""
    row = Json(client.attitude(spacecraft))
    if not as_json:
        other = Json(client.attitude(spacecraft, "paper" if row["method"] == "robust" else "robust"))
        control = Json(client.control(spacecraft))

    def parts() -> "Iterator[RenderableType]":
        said = [tables.meaning("statuses", row["status"]), tables.meaning("statuses", row["status"], "next")]
        yield f"{spacecraft}, {tables.utc(row['epoch'])} UTC: {'; '.join(filter(None, said))}"
        yield tables.axes_table(row, other, control)
        yield f"{row['carriers_used']} carriers used, left out: {tables.excluded_line(row)}"
        fade = (
            f"{tables.number(row['downlink_fade_db'], 2)} dB"
            if row["downlink_fade"]
            else tables.words("views.now.none")
        )
        residual = tables.number(row["residual_rms_db"], 2)
        yield f"{tables.words('views.now.fade')}: {fade}; {tables.words('views.now.residual')}: {residual} dB"
        for code in row["inhibitions"]:
            yield f"{tables.meaning('reasons', code)}: {tables.meaning('reasons', code, 'next')}"

    tables.show(row, parts, as_json=as_json)
    if row["status"] != "ACQUIRED":
        raise typer.Exit(EXIT_ATTENTION)


@on_service
def carriers(client: "ServiceClient", spacecraft: SpacecraftOption, as_json: JsonOption = False) -> None:
    """Say which carriers the newest attitude uses, which it leaves out, and why."""
    plan, row = client.carriers(spacecraft), Json(client.attitude(spacecraft))
    reasons = {each["carrier"]: each["reason"] for each in row["excluded"]}

    def parts() -> "Iterator[RenderableType]":
        count = tables.words("views.now.used", used=row["carriers_used"], all=len(plan["carriers"]))
        yield f"{spacecraft}, {tables.utc(row['epoch'])} UTC: {count}"
        table = tables.columns("carrier", "state", "next step", "transponder", "station")
        for each in sorted(plan["carriers"], key=lambda one: one["id"] not in reasons):
            reason = reasons.get(each["id"])
            used = "carrierUsed" if each["enabled"] and row["epoch"] else "noRow" if each["enabled"] else "carrierOff"
            table.add_row(
                tables.clean(each["id"]),
                tables.words(f"views.now.{used}") if reason is None else tables.meaning("exclusions", reason),
                "" if reason is None else tables.meaning("exclusions", reason, "next"),
                tables.clean(each["transponder"]),
                tables.clean((each["station"] or {}).get("name") or ""),
            )
        yield table

    tables.show({"carriers": plan, "attitude": row}, parts, as_json=as_json)
    if reasons:
        raise typer.Exit(EXIT_ATTENTION)


@on_service
def alarms(client: "ServiceClient", spacecraft: SpacecraftOption, as_json: JsonOption = False) -> None:
    """List open alarms with their ids and next steps."""
    rows = tables.worst_first(client.pages(f"/spacecraft/{spacecraft}/alarms"))
    tables.show(
        {"rows": rows},
        lambda: chain(*map(tables.alarm_lines, rows)) if rows else [f"{spacecraft}: {tables.words('app.alarms.none')}"],
        as_json=as_json,
    )
    if rows:
        raise typer.Exit(EXIT_ATTENTION)
