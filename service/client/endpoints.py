"""The REST contract as methods: each endpoint is written once, for the blocking and for the awaiting client.

A decorator makes a request, given as a value, a method of both.
"""

from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, Concatenate, Generic, Literal, ParamSpec, TypeVar, overload
from urllib.parse import quote, urlencode

from service.client.async_transport import AsyncTransport
from service.client.call import Call, Epoch, EventKind, Follower, StreamEvent, epoch_text, epochs, given, window
from service.client.documents import (
    Attitude,
    CommandReply,
    Control,
    JobReply,
    Json,
    MeasurementReply,
    PlanPut,
    Receipt,
    StatusReply,
)
from service.client.transport import Transport

P = ParamSpec("P")
Result = TypeVar("Result")
Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Series(Generic[Item]):
    """Items of one path: rows of a list, page after page, or the events of a stream where a follower is given."""

    path: str
    params: Mapping[str, Any] = field(default_factory=dict)
    follower: Follower | None = None


class _Method(Generic[P, Result]):
    """Descriptor of a function that returns a request; the class of the instance decides how the request is sent."""

    def __init__(self, request: Callable[Concatenate[Any, P], Any]) -> None:
        self._request = request

    def _bound(self, client: Any, send: Callable[[Any], Any]) -> Callable[P, Any]:
        request: Callable[P, Any] = self._request.__get__(client)

        @wraps(request)
        def method(*args: P.args, **kwargs: P.kwargs) -> Any:
            return send(request(*args, **kwargs))

        return method


class endpoint(_Method[P, Result]):  # noqa: N801 a decorator
    """Method that returns the answer of one request, or that is awaited for it."""

    def __init__(self, request: Callable[Concatenate[Any, P], Call[Result]]) -> None:
        super().__init__(request)

    @overload
    def __get__(self, client: None, owner: type) -> Callable[..., Any]: ...
    @overload
    def __get__(self, client: Transport, owner: type) -> Callable[P, Result]: ...
    @overload
    def __get__(self, client: AsyncTransport, owner: type) -> Callable[P, Coroutine[Any, Any, Result]]: ...
    def __get__(self, client: Transport | AsyncTransport | None, owner: type) -> Callable[..., Any]:
        """Return the method of a client, or of the class the function itself."""
        return self._request if client is None else self._bound(client, client.send)


class series(_Method[P, Item]):  # noqa: N801 a decorator
    """Method that yields the items of a series."""

    def __init__(self, request: Callable[Concatenate[Any, P], Series[Item]]) -> None:
        super().__init__(request)

    @overload
    def __get__(self, client: None, owner: type) -> Callable[..., Any]: ...
    @overload
    def __get__(self, client: Transport, owner: type) -> Callable[P, Iterator[Item]]: ...
    @overload
    def __get__(self, client: AsyncTransport, owner: type) -> Callable[P, AsyncIterator[Item]]: ...
    def __get__(self, client: Transport | AsyncTransport | None, owner: type) -> Callable[..., Any]:
        """Return the method of a client, or of the class the function itself."""
        if client is None:
            return self._request

        def items(wanted: Series[Item]) -> Any:
            if wanted.follower is not None:
                return client.follow(wanted.path, wanted.follower)
            return client.pages(wanted.path, wanted.params)

        return self._bound(client, items)


Rows = Sequence[Mapping[str, Any]]
#: rows a page when nothing else is said: the most that the service gives
PAGE_ROWS = 10_000


def below(spacecraft_id: str, path: str = "") -> str:
    """Return a path of one spacecraft."""
    return f"/spacecraft/{spacecraft_id}{path}"


def batch(spacecraft_id: str, kind: str, body: Mapping[str, Any]) -> Call[Any]:
    """Return a batch of rows; the service keys them by content, so repeating it is safe."""
    return Call("POST", below(spacecraft_id, f"/{kind}:batch"), body, is_keyed=True)


class CatalogueEndpoints:
    """Methods of the catalogue."""

    @endpoint
    def create_spacecraft(self, spacecraft: Mapping[str, Any]) -> Call[Json]:
        """Add a spacecraft."""
        return Call("POST", "/spacecraft", spacecraft)

    @endpoint
    def spacecraft(self, spacecraft_id: str) -> Call[Json]:
        """Return one spacecraft."""
        return Call("GET", below(spacecraft_id))

    @endpoint
    def put_carriers(self, spacecraft_id: str, carriers: Rows) -> Call[PlanPut]:
        """Store a carrier plan; the same content gives the same plan_id."""
        return Call("PUT", below(spacecraft_id, "/carriers"), {"carriers": list(carriers)})

    @endpoint
    def carriers(self, spacecraft_id: str, plan_id: int | None = None) -> Call[Json]:
        """Return the newest carrier plan, or the one with this number."""
        return Call("GET", below(spacecraft_id, "/carriers"), params={"plan_id": plan_id})

    @endpoint
    def put_ephemeris(self, spacecraft_id: str, ephemeris: Mapping[str, Any]) -> Call[Json]:
        """Store an ephemeris: nodes and period, TLE, or OEM."""
        return Call("PUT", below(spacecraft_id, "/ephemeris"), ephemeris)


class IngestEndpoints:
    """Methods that send."""

    @endpoint
    def post_measurements(
        self,
        spacecraft_id: str,
        plan_id: int,
        measurements: Rows,
        *,
        source: str | None = None,
        first_seq: int | None = None,
    ) -> Call[Receipt]:
        """Send rows of carrier powers; repeating a batch is safe."""
        body = {"plan_id": plan_id, "measurements": list(measurements)}
        body |= given(source=source, first_seq=first_seq)
        return batch(spacecraft_id, "measurements", body)

    @endpoint
    def post_traces(self, spacecraft_id: str, source: str, traces: Rows) -> Call[Json]:
        """Send evidence traces of one source; repeating them is safe, the service keeps a ring of the newest."""
        body = {"source": source, "traces": list(traces)}
        return Call("POST", below(spacecraft_id, "/traces"), body, is_keyed=True)

    @endpoint
    def report_links(self, links: Rows) -> Call[list[Json]]:
        """Report the state of links and return what the operator wants of each: id, enabled, reset."""
        return Call("POST", "/links:report", {"links": list(links)}, is_keyed=True, member="links")

    @endpoint
    def post_references(self, spacecraft_id: str, source: str, references: Rows) -> Call[Json]:
        """Send attitude references."""
        return batch(spacecraft_id, "attitude-references", {"source": source, "references": list(references)})

    @endpoint
    def post_weather(self, spacecraft_id: str, source: str, reports: Rows) -> Call[Json]:
        """Send reports of rain over uplink stations."""
        return batch(spacecraft_id, "weather", {"source": source, "reports": list(reports)})

    @endpoint
    def post_polarization(self, spacecraft_id: str, source: str, records: Rows) -> Call[Json]:
        """Send polarisation records of one polarimeter."""
        return batch(spacecraft_id, "polarization", {"source": source, "records": list(records)})

    @endpoint
    def post_corrections(self, spacecraft_id: str, corrections: Rows) -> Call[Json]:
        """Send attitude changes commanded through other channels."""
        return batch(spacecraft_id, "corrections", {"corrections": list(corrections)})

    @endpoint
    def post_operation(self, spacecraft_id: str, operation: Mapping[str, Any]) -> Call[Json]:
        """Announce an operation (station keeping, eclipse, carrier work)."""
        return Call("POST", below(spacecraft_id, "/operations"), operation)


class JobEndpoints:
    """Methods that start what takes time, and look at it."""

    @endpoint
    def start_calibration(self, spacecraft_id: str, calibration: Mapping[str, Any]) -> Call[Json]:
        """Start a calibration; the answer names its job."""
        return Call("POST", below(spacecraft_id, "/calibrations"), calibration)

    @endpoint
    def calibration(self, spacecraft_id: str, calibration_id: int) -> Call[Json]:
        """Return one calibration with its carriers."""
        return Call("GET", below(spacecraft_id, f"/calibrations/{calibration_id}"))

    @endpoint
    def activate_calibration(
        self, spacecraft_id: str, calibration_id: int, override_reason: str | None = None
    ) -> Call[Json]:
        """Make a calibration the active one of its method; inconsistent turns need a reason."""
        body = {"override_reason": override_reason} if override_reason else None
        return Call("POST", below(spacecraft_id, f"/calibrations/{calibration_id}:activate"), body)

    @endpoint
    def align(self, spacecraft_id: str, alignment: Mapping[str, Any]) -> Call[Json]:
        """Tie the estimator to known angles."""
        return Call("POST", below(spacecraft_id, "/alignments"), alignment)

    @endpoint
    def job(self, job_id: str) -> Call[JobReply]:
        """Return the state and progress of a job."""
        return Call("GET", f"/jobs/{job_id}")

    @endpoint
    def start_replay(self, spacecraft_id: str, replay: Mapping[str, Any]) -> Call[Json]:
        """Start a replay; the answer names its job and its version."""
        return Call("POST", below(spacecraft_id, "/replays"), replay)

    @endpoint
    def replay(self, spacecraft_id: str, replay_id: int) -> Call[Json]:
        """Return one replay: span, state, rows, bytes."""
        return Call("GET", below(spacecraft_id, f"/replays/{replay_id}"))

    @series
    def replays(
        self, spacecraft_id: str, start: Epoch | None = None, stop: Epoch | None = None, *, limit: int = PAGE_ROWS
    ) -> Series[Json]:
        """Yield the replays whose span overlaps an interval, in order of their numbers."""
        return Series(below(spacecraft_id, "/replays"), window(start, stop, limit))

    @endpoint
    def delete_replay(self, spacecraft_id: str, replay_id: int) -> Call[None]:
        """Delete a replay and its rows; one that runs or waits ends."""
        return Call("DELETE", below(spacecraft_id, f"/replays/{replay_id}"))


class ReleaseEndpoints:
    """Methods of commands and control."""

    @endpoint
    def prepare_torques(
        self,
        spacecraft_id: str,
        reason: str,
        *,
        attitude_epoch: Epoch | None = None,
        start: Epoch | None = None,
        duration_s: float | None = None,
        max_torque_n_m: float | None = None,
        dry_run: bool = False,
    ) -> Call[CommandReply]:
        """Return a command that waits for another person to confirm its digest.

        Never sent twice: a second request would be another command.

        Parameters
        ----------
        spacecraft_id, reason : str
            Spacecraft, and why.
        attitude_epoch, start : str or int, optional
            Estimate that was looked at, default the newest; begin of the schedule, default as soon as can be.
        duration_s, max_torque_n_m : float, optional
            Default the forecast horizon of the spacecraft, and the limits of spacecraft and wheels.
        dry_run : bool
            Only look: nothing is stored, and failing checks are reported instead of refused.
        """
        body = {"reason": reason, "dry_run": dry_run, "duration_s": duration_s, "max_torque_n_m": max_torque_n_m}
        return Call(
            "POST",
            below(spacecraft_id, "/torques:prepare"),
            body | epochs(attitude_epoch=attitude_epoch, start=start),
        )

    @endpoint
    def command(self, spacecraft_id: str, command_id: int) -> Call[CommandReply]:
        """Return one command as it stands."""
        return Call("GET", below(spacecraft_id, f"/torques/{command_id}"))

    @series
    def commands(
        self, spacecraft_id: str, start: Epoch | None = None, stop: Epoch | None = None, *, limit: int = PAGE_ROWS
    ) -> Series[CommandReply]:
        """Yield every command that was prepared in an interval; parameters as for `attitude_history`."""
        return Series(below(spacecraft_id, "/torques/commands"), window(start, stop, limit))

    @endpoint
    def confirm_torques(
        self, spacecraft_id: str, command_id: int, digest: str, comment: str = ""
    ) -> Call[CommandReply]:
        """Return a command that another person prepared, released.

        Never sent twice: a second request would be refused though the first released the command.
        """
        path = below(spacecraft_id, f"/torques/{command_id}:confirm")
        return Call("POST", path, {"digest": digest, "comment": comment})

    @endpoint
    def cancel_torques(self, spacecraft_id: str, command_id: int, comment: str = "") -> Call[CommandReply]:
        """Take a prepared command back."""
        return Call("POST", below(spacecraft_id, f"/torques/{command_id}:cancel"), {"comment": comment})

    @endpoint
    def report_torques(
        self,
        spacecraft_id: str,
        command_id: int,
        turn: Literal["sent", "executed", "failed"],
        *,
        at: Epoch | None = None,
        executed_from: Epoch | None = None,
        executed_until: Epoch | None = None,
    ) -> Call[CommandReply]:
        """Report what became of a released command; repeating a report is safe.

        Parameters
        ----------
        spacecraft_id, command_id : str and int
            Which command.
        turn : str
            ``sent``, ``executed`` or ``failed``.
        at : str or int, optional
            When; default now.
        executed_from, executed_until : str or int, optional
            Part that was carried out; default all of it (executed) or nothing (failed).
        """
        body = epochs(at=at, executed_from=executed_from, executed_until=executed_until)
        return Call("POST", below(spacecraft_id, f"/torques/{command_id}:{turn}"), body, is_keyed=True)

    @endpoint
    def uplink(self, spacecraft_id: str, command_id: int) -> Call[Json]:
        """Return what goes up of a released command."""
        return Call("GET", below(spacecraft_id, f"/torques/{command_id}/uplink"))

    @endpoint
    def attitude_uplink(self, spacecraft_id: str) -> Call[Json]:
        """Return the newest angles for a spacecraft in mode onboard."""
        return Call("GET", below(spacecraft_id, "/attitude/uplink"))

    @endpoint
    def control(self, spacecraft_id: str) -> Call[Control]:
        """Return what the interlock says, and why."""
        return Call("GET", below(spacecraft_id, "/control"))

    @endpoint
    def order_control(
        self, spacecraft_id: str, order: Literal["arm", "disengage", "reset", "stop"], comment: str = ""
    ) -> Call[Control]:
        """Give the interlock an order; a comment goes to the shift log."""
        return _order(spacecraft_id, order, comment)

    @endpoint
    def engage_control(
        self, spacecraft_id: str, until: Epoch, envelope: Mapping[str, float] | None = None, comment: str = ""
    ) -> Call[Control]:
        """Ask for standing authorisation, or join another person who asked for the same."""
        return _order(spacecraft_id, "engage", comment, until=epoch_text(until), envelope=envelope)

    @endpoint
    def check_sign(self, spacecraft_id: str, axis: str | None = None, comment: str = "") -> Call[Control]:
        """Begin to prove the sign of an axis; default the first that is not proven."""
        return _order(spacecraft_id, "sign-check", comment, axis=axis)


def _order(spacecraft_id: str, order: str, comment: str, **others: Any) -> Call[Control]:
    """Return an order to the interlock; its name stands behind the colon of the path."""
    return Call("POST", below(spacecraft_id, f"/control:{order}"), {**others, "comment": comment})


class ResultEndpoints:
    """Methods that read."""

    @series
    def stream(
        self,
        spacecraft_id: str,
        *,
        last_event_id: str | None = None,
        patience_s: float | None = None,
        events: Sequence[EventKind] = (),
    ) -> Series[StreamEvent]:
        """Yield what happens to a spacecraft, without end; a lost connection is made again where it broke off.

        It goes on behind ``last_event_id``, None: with the present, and waits for a service that is away for
        ``patience_s``, None: for ever. ``events`` are kinds, all by default; ``dropped`` comes in any case.
        """
        chosen = f"?{urlencode({'events': events}, doseq=True)}" if events else ""
        return Series(below(spacecraft_id, f"/stream{chosen}"), follower=Follower(last_event_id, patience_s))

    @endpoint
    def about(self) -> Call[Json]:
        """Return version, clock, settings in force without secrets, and licences of the service."""
        return Call("GET", "/about")

    @endpoint
    def status(self, spacecraft_id: str) -> Call[StatusReply]:
        """Return what is newest, pending and in force."""
        return Call("GET", below(spacecraft_id, "/status"))

    @endpoint
    def measurements(self, spacecraft_id: str) -> Call[Json]:
        """Return the newest row of carrier powers."""
        return Call("GET", below(spacecraft_id, "/measurements"))

    @endpoint
    def attitude(self, spacecraft_id: str, method: str | None = None) -> Call[Attitude]:
        """Return the newest attitude."""
        return Call("GET", below(spacecraft_id, "/attitude"), params={"method": method})

    @endpoint
    def torques(self, spacecraft_id: str) -> Call[Json]:
        """Return the newest computed torque command."""
        return Call("GET", below(spacecraft_id, "/torques"))

    @series
    def measurement_history(
        self, spacecraft_id: str, start: Epoch | None = None, stop: Epoch | None = None, *, limit: int = PAGE_ROWS
    ) -> Series[MeasurementReply]:
        """Yield every row of carrier powers of an interval; parameters as for `attitude_history`."""
        return Series(below(spacecraft_id, "/measurements/history"), window(start, stop, limit))

    @series
    def attitude_history(
        self,
        spacecraft_id: str,
        start: Epoch | None = None,
        stop: Epoch | None = None,
        *,
        method: str | None = None,
        version: str | None = None,
        limit: int = PAGE_ROWS,
    ) -> Series[Attitude]:
        """Yield every attitude row of an interval, page after page.

        Parameters
        ----------
        spacecraft_id : str
            Spacecraft.
        start, stop : str or int, optional
            RFC 3339 text or microseconds UTC; start inclusive, stop exclusive.
        method, version : str, optional
            ``robust`` or ``paper``; ``live`` or the version of a replay.
        limit : int
            Rows a page.
        """
        params = {**window(start, stop, limit), "method": method, "version": version}
        return Series(below(spacecraft_id, "/attitude/history"), params)

    @series
    def smoothed_attitude(
        self, spacecraft_id: str, start: Epoch | None = None, stop: Epoch | None = None, *, limit: int = PAGE_ROWS
    ) -> Series[Attitude]:
        """Yield every row of the live series of smoothed angles; parameters as for `attitude_history`."""
        return Series(below(spacecraft_id, "/attitude/smoothed"), window(start, stop, limit))

    @series
    def carrier_results(
        self,
        spacecraft_id: str,
        carrier: str,
        start: Epoch | None = None,
        stop: Epoch | None = None,
        *,
        method: str | None = None,
        version: str | None = None,
        limit: int = PAGE_ROWS,
    ) -> Series[Json]:
        """Yield what a method made of one carrier at every row; other parameters as for `attitude_history`."""
        params = {**window(start, stop, limit), "method": method, "version": version}
        return Series(below(spacecraft_id, f"/carriers/{quote(carrier, safe='')}/results"), params)

    @endpoint
    def samples(
        self,
        spacecraft_id: str,
        quantities: Sequence[str],
        start: Epoch | None = None,
        stop: Epoch | None = None,
        *,
        methods: Sequence[str] = (),
        carriers: Sequence[str] = (),
        source: str | None = None,
        version: str | None = None,
        count: int = 500,
    ) -> Call[Json]:
        """Return mean, least and greatest value of some quantities in the intervals of a span, column by column.

        Parameters
        ----------
        spacecraft_id : str
            Spacecraft.
        quantities : sequence of str
            Such as ``roll_deg``, ``residual_db``, ``power_dbm``; their units stand in their names.
        start, stop : str or int, optional
            RFC 3339 text or microseconds UTC; default the first and the newest row.
        methods, carriers : sequence of str
            Default all.
        source : str, optional
            Only rows of this source, of powers and C/N0; default every source.
        version : str, optional
            ``live`` or the version of a replay.
        count : int
            Intervals that the span is cut into.
        """
        params = {**epochs(start=start, stop=stop), "quantity": list(quantities), "version": version, "count": count}
        params |= {"method": list(methods) or None, "carrier": list(carriers) or None, "source": source}
        return Call("GET", below(spacecraft_id, "/samples"), params=params)

    @endpoint
    def timeline(
        self, spacecraft_id: str, start: Epoch | None = None, stop: Epoch | None = None, *, methods: Sequence[str] = ()
    ) -> Call[Json]:
        """Return intervals and marks of a span: states, gaps, operations, commands, alarms, notes."""
        params = {**epochs(start=start, stop=stop), "method": list(methods) or None}
        return Call("GET", below(spacecraft_id, "/timeline"), params=params)


class Endpoints(CatalogueEndpoints, IngestEndpoints, JobEndpoints, ResultEndpoints, ReleaseEndpoints):
    """Methods that both clients have; here each returns the request that a client sends."""
