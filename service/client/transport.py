"""One request to the service: key, JSON, errors, and retries where a second attempt cannot do harm.

Law of this file: GET and PUT are repeated, and POSTs that the service keys by content (``:batch``); any other POST only
when the connection was never made. A request that may have been carried out is never sent twice.
"""

import json
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Self

import httpx

from service.client.backoff import Backoff
from service.client.problem import ServiceUnavailableError, error_of

Json = dict[str, Any]

#: base path of the API, version 1
BASE_PATH = "/api/v1"
_REPEATABLE = frozenset({"GET", "HEAD", "PUT", "DELETE"})


class Transport:
    """Send requests with one key to one service.

    Parameters
    ----------
    service_url : str
        For example ``http://127.0.0.1:8000``.
    key : str or None
        Bearer key; None for endpoints that need none.
    timeout_s : float
        Bound on connecting and on every read.
    retries : int
        Further attempts after the first where a repetition is safe.
    http : httpx.BaseTransport, optional
        In place of the network, for tests.
    sleep : callable
        Waits between attempts.
    first_wait_s : float
        Waiting time before the second attempt; doubles.
    """

    def __init__(
        self,
        service_url: str,
        key: str | None = None,
        *,
        timeout_s: float = 10.0,
        retries: int = 3,
        http: httpx.BaseTransport | None = None,
        sleep: Callable[[float], None] = time.sleep,
        first_wait_s: float = 0.5,
    ) -> None:
        headers = {"Accept": "application/json", "User-Agent": "soo-client/1"}
        if key:
            headers["Authorization"] = f"Bearer {key}"
        # The environment's proxies are not used: a key for the station network stays in it.
        self._http = httpx.Client(
            base_url=service_url.rstrip("/"), headers=headers, timeout=timeout_s, transport=http, trust_env=False
        )
        self._retries = retries
        self._sleep = sleep
        self._first_wait_s = first_wait_s

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def request(
        self,
        method: str,
        path: str,
        body: Mapping[str, Any] | None = None,
        *,
        params: Mapping[str, Any] | None = None,
        is_keyed: bool = False,
    ) -> Any:
        """Return the decoded answer of one request.

        Parameters
        ----------
        method : str
            HTTP method.
        path : str
            Below ``/api/v1`` unless it names one of the endpoints outside (``/healthz``).
        body : mapping, optional
            Sent as JSON; NaN is refused here already.
        params : mapping, optional
            Query; None values are left out.
        is_keyed : bool
            The service recognises a repetition of this request by its content.

        Raises
        ------
        ProblemError
            The service refused.
        ServiceUnavailableError
            No answer, or try later, after all attempts.
        """
        content = None if body is None else json.dumps(body, allow_nan=False, separators=(",", ":")).encode()
        query = {name: value for name, value in (params or {}).items() if value is not None}
        is_safe = is_keyed or method in _REPEATABLE
        backoff = Backoff(first_s=self._first_wait_s, limit_s=10.0)
        for attempt in range(self._retries + 1):
            try:
                return self._send(method, path, content, query)
            except ServiceUnavailableError as error:
                was_never_sent = isinstance(error.__cause__, httpx.ConnectError)
                if attempt == self._retries or not (is_safe or was_never_sent):
                    raise
                self._sleep(error.retry_after_s or backoff.next_s())
        raise AssertionError  # pragma: no cover - the loop returns or raises

    def download(
        self,
        path: str,
        params: Mapping[str, Any] | None = None,
        *,
        headers: Mapping[str, str] | None = None,
        on_status: Callable[[int], None] = lambda _: None,
    ) -> Iterator[bytes]:
        """Yield the body of a GET as it comes, never the whole of it; asked once, for a part cannot be taken back.

        Parameters
        ----------
        path : str
            Below ``/api/v1``.
        params : mapping, optional
            Query; None values are left out.

        Raises
        ------
        ProblemError
            The service refused.
        ServiceUnavailableError
            No answer, or the answer broke off.
        """
        query = {name: value for name, value in (params or {}).items() if value is not None} or None
        told = {"Accept": "*/*", **(headers or {})}
        try:
            with self._http.stream("GET", BASE_PATH + path, params=query, headers=told) as response:
                if not response.is_success:
                    response.read()
                    raise error_of(response)
                on_status(response.status_code)
                yield from response.iter_bytes()
        except httpx.TransportError as error:
            message = f"the download of {path} broke off: {type(error).__name__} {error}".rstrip()
            raise ServiceUnavailableError(message) from error

    def _send(self, method: str, path: str, content: bytes | None, query: Mapping[str, Any]) -> Any:
        """Send once."""
        url = path if path in {"/healthz", "/readyz", "/openapi.json"} else BASE_PATH + path
        headers = {"Content-Type": "application/json"} if content is not None else None
        try:
            response = self._http.request(method, url, content=content, params=query, headers=headers)
        except httpx.TransportError as error:
            what = type(error).__name__
            message = f"no answer from {self._http.base_url} to {method} {url}: {what} {error}".rstrip()
            raise ServiceUnavailableError(message) from error
        if not response.is_success:
            raise error_of(response)
        return _decoded(response)


def _decoded(response: httpx.Response) -> Any:
    """Return the JSON of a good answer, None for an empty one."""
    if not response.content:
        return None
    try:
        return response.json()
    except ValueError as error:
        message = f"{response.request.url} answered {response.status_code} with something that is not JSON"
        raise ServiceUnavailableError(message, response.status_code) from error
