"""Out of the service: newest rows, histories, samples, timeline, stream, and the service itself."""

from collections.abc import Sequence
from urllib.parse import quote, urlencode

from service.client.call import Call, Epoch, epochs, window
from service.client.documents import Attitude, Json, MeasurementReply, StatusReply
from service.client.endpoint_methods import Series, endpoint, series
from service.client.endpoints.paths import PAGE_ROWS, below
from service.client.event_lines import EventKind, Follower, StreamEvent


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
    def beams(
        self, spacecraft_id: str, start: Epoch | None = None, stop: Epoch | None = None, *, group: str | None = None
    ) -> Call[Json]:
        """Return boresights of the antennas and beams at the stations; ``group``: ``band`` or ``transponder``."""
        params = {**epochs(start=start, stop=stop), "group": group}
        return Call("GET", below(spacecraft_id, "/beams"), params=params)

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
