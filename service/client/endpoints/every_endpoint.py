"""Every endpoint in one class."""

from service.client.endpoints.catalogue import CatalogueEndpoints
from service.client.endpoints.ingest import IngestEndpoints
from service.client.endpoints.jobs import JobEndpoints
from service.client.endpoints.release import ReleaseEndpoints
from service.client.endpoints.results import ResultEndpoints


class Endpoints(CatalogueEndpoints, IngestEndpoints, JobEndpoints, ResultEndpoints, ReleaseEndpoints):
    """Methods that both clients have; here each returns the request that a client sends."""
