"""Into the service: rows of stations, references, weather, polarisation, corrections, operations."""

from collections.abc import Mapping
from typing import Any

from service.client.call import Call, given
from service.client.documents import Json, Receipt
from service.client.endpoint_methods import endpoint
from service.client.endpoints.paths import Rows, batch, below


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
