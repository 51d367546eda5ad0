"""The REST contract as values: one function an endpoint gives the request and says what its answer holds.

Nothing is interpreted here; epochs go in as RFC 3339 text or as int64 microseconds UTC.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from service.client.call import Call, Epoch, epoch_text
from service.client.documents import Attitude, Command, Control, Job, Json, PlanPut, Receipt, Status

Rows = Sequence[Mapping[str, Any]]
#: rows a page when nothing else is said: the most that the service gives
PAGE_ROWS = 10_000


def below(spacecraft_id: str, path: str = "") -> str:
    """Return a path of one spacecraft."""
    return f"/spacecraft/{spacecraft_id}{path}"


def create_spacecraft(spacecraft: Mapping[str, Any]) -> Call[Json]:
    """Add a spacecraft."""
    return Call("POST", "/spacecraft", spacecraft)


def spacecraft(spacecraft_id: str) -> Call[Json]:
    """Look up one spacecraft."""
    return Call("GET", below(spacecraft_id))


def put_carriers(spacecraft_id: str, carriers: Rows) -> Call[PlanPut]:
    """Store a carrier plan; the same content gives the same plan_id."""
    return Call("PUT", below(spacecraft_id, "/carriers"), {"carriers": list(carriers)})


def carriers(spacecraft_id: str, plan_id: int | None) -> Call[Json]:
    """Look up the newest carrier plan, or the one with this number."""
    return Call("GET", below(spacecraft_id, "/carriers"), params={"plan_id": plan_id})


def put_ephemeris(spacecraft_id: str, ephemeris: Mapping[str, Any]) -> Call[Json]:
    """Store an ephemeris."""
    return Call("PUT", below(spacecraft_id, "/ephemeris"), ephemeris)


def post_measurements(
    spacecraft_id: str, plan_id: int, measurements: Rows, source: str | None, first_seq: int | None
) -> Call[Receipt]:
    """Send rows of carrier powers."""
    named = {"source": source, "first_seq": first_seq}
    body = {"plan_id": plan_id, "measurements": list(measurements)}
    body |= {name: value for name, value in named.items() if value is not None}
    return Call("POST", below(spacecraft_id, "/measurements:batch"), body, is_keyed=True)


def post_batch(spacecraft_id: str, kind: str, body: Mapping[str, Any]) -> Call[Json]:
    """Send a batch of slow inputs; the service keys its rows by content, so repeating it is safe."""
    return Call("POST", below(spacecraft_id, f"/{kind}:batch"), body, is_keyed=True)


def post_traces(spacecraft_id: str, source: str, traces: Rows) -> Call[Json]:
    """Send evidence traces."""
    return Call("POST", below(spacecraft_id, "/traces"), {"source": source, "traces": list(traces)}, is_keyed=True)


def report_links(links: Rows) -> Call[Json]:
    """Report the state of links; a report that is told twice says the same twice."""
    return Call("POST", "/links:report", {"links": list(links)}, is_keyed=True)


def post_operation(spacecraft_id: str, operation: Mapping[str, Any]) -> Call[Json]:
    """Announce an operation."""
    return Call("POST", below(spacecraft_id, "/operations"), operation)


def start_calibration(spacecraft_id: str, calibration: Mapping[str, Any]) -> Call[Json]:
    """Start a calibration."""
    return Call("POST", below(spacecraft_id, "/calibrations"), calibration)


def calibration(spacecraft_id: str, calibration_id: int) -> Call[Json]:
    """Look up one calibration."""
    return Call("GET", below(spacecraft_id, f"/calibrations/{calibration_id}"))


def activate_calibration(spacecraft_id: str, calibration_id: int) -> Call[Json]:
    """Make a calibration the active one of its method."""
    return Call("POST", below(spacecraft_id, f"/calibrations/{calibration_id}:activate"))


def align(spacecraft_id: str, alignment: Mapping[str, Any]) -> Call[Json]:
    """Tie the estimator to known angles."""
    return Call("POST", below(spacecraft_id, "/alignments"), alignment)


def job(job_id: str) -> Call[Job]:
    """Look up a job."""
    return Call("GET", f"/jobs/{job_id}")


def status(spacecraft_id: str) -> Call[Status]:
    """Look up what is newest, pending and in force."""
    return Call("GET", below(spacecraft_id, "/status"))


def measurements(spacecraft_id: str) -> Call[Json]:
    """Look up the newest row of carrier powers."""
    return Call("GET", below(spacecraft_id, "/measurements"))


def attitude(spacecraft_id: str, method: str | None) -> Call[Attitude]:
    """Look up the newest attitude."""
    return Call("GET", below(spacecraft_id, "/attitude"), params={"method": method})


def torques(spacecraft_id: str) -> Call[Json]:
    """Look up the newest computed torque command."""
    return Call("GET", below(spacecraft_id, "/torques"))


def prepare_torques(
    spacecraft_id: str,
    reason: str,
    epochs: Mapping[str, Epoch | None],
    figures: Mapping[str, float | None],
    *,
    dry_run: bool,
) -> Call[Command]:
    """Have a command prepared; never sent twice, for a second one would be another command."""
    told = {name: epoch_text(at) for name, at in epochs.items() if at is not None}
    wish = {"reason": reason, "dry_run": dry_run, **told, **figures}
    return Call("POST", below(spacecraft_id, "/torques:prepare"), wish)


def command(spacecraft_id: str, command_id: int) -> Call[Command]:
    """Look up a command."""
    return Call("GET", below(spacecraft_id, f"/torques/{command_id}"))


def confirm_torques(spacecraft_id: str, command_id: int, digest: str, comment: str) -> Call[Command]:
    """Confirm a command; never sent twice: a second one would be refused though the first released it."""
    path = below(spacecraft_id, f"/torques/{command_id}:confirm")
    return Call("POST", path, {"digest": digest, "comment": comment})


def cancel_torques(spacecraft_id: str, command_id: int, comment: str) -> Call[Command]:
    """Take a prepared command back."""
    return Call("POST", below(spacecraft_id, f"/torques/{command_id}:cancel"), {"comment": comment})


def report_torques(spacecraft_id: str, command_id: int, turn: str, told: Mapping[str, Any]) -> Call[Command]:
    """Report what became of a command; the same report again changes nothing, so it may be sent again."""
    body = {name: epoch_text(at) for name, at in told.items() if at is not None}
    return Call("POST", below(spacecraft_id, f"/torques/{command_id}:{turn}"), body, is_keyed=True)


def uplink(spacecraft_id: str, command_id: int) -> Call[Json]:
    """Look up what goes up of a released command."""
    return Call("GET", below(spacecraft_id, f"/torques/{command_id}/uplink"))


def attitude_uplink(spacecraft_id: str) -> Call[Json]:
    """Look up the newest angles for uplink."""
    return Call("GET", below(spacecraft_id, "/attitude/uplink"))


def control(spacecraft_id: str) -> Call[Control]:
    """Look up what the interlock says."""
    return Call("GET", below(spacecraft_id, "/control"))


def order_control(spacecraft_id: str, order: str, body: Mapping[str, Any]) -> Call[Control]:
    """Order the interlock; `order` is what stands behind the colon of the path."""
    return Call("POST", below(spacecraft_id, f"/control:{order}"), body)


def engage_control(
    spacecraft_id: str, until: Epoch, envelope: Mapping[str, float] | None, comment: str
) -> Call[Control]:
    """Ask for standing authorisation."""
    body = {"until": epoch_text(until), "envelope": envelope, "comment": comment}
    return order_control(spacecraft_id, "engage", body)


def start_closed_loop(wish: Mapping[str, Any]) -> Call[Json]:
    """Start a flight in the orbital frame."""
    return Call("POST", "/analyses/closed-loop", wish)


def closed_loop(job_id: str) -> Call[Json]:
    """Look up what a flight gave."""
    return Call("GET", f"/analyses/closed-loop/{job_id}")


def window(start: Epoch | None, stop: Epoch | None, limit: int, **filters: Any) -> Json:
    """Return the query of a history."""
    span = {"start": start, "stop": stop}
    return {**{name: None if at is None else epoch_text(at) for name, at in span.items()}, **filters, "limit": limit}


def page(path: str, params: Mapping[str, Any], cursor: str | None) -> Call[Json]:
    """Ask for one page of a list."""
    return Call("GET", path, params={**params, "cursor": cursor})
