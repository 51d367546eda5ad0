"""Requests to the service, one after another: key, JSON, errors, and retries where they cannot do harm."""

import time
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing
from typing import Any, Self, TypeVar

import httpx

from service.client import call as calls
from service.client.documents import Json
from service.client.problem import ServiceUnavailableError, error_of

Result = TypeVar("Result")
#: statuses of a key that is not valid, or not for this
_KEY_REFUSED = frozenset({401, 403})


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
    stored_key : callable
        Key as it is stored now, asked where the service refuses the one in use; None = it cannot be read.
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
        stored_key: Callable[[], str | None] = lambda: None,
    ) -> None:
        # The environment's proxies are not used: a key for the station network stays in it.
        self._http = httpx.Client(
            base_url=service_url.rstrip("/"),
            headers=calls.default_headers(key),
            timeout=timeout_s,
            transport=http,
            trust_env=False,
        )
        self.service_url = service_url
        self._retries = retries
        self._sleep = sleep
        self._first_wait_s = first_wait_s
        self._stored_key = stored_key

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
        """Send any request below ``/api/v1``; see `service.client.call.Call`."""
        call: calls.Call[Any] = calls.Call(method, path, body, params or {}, is_keyed)
        return self.send(call)

    def send(self, call: calls.Call[Result]) -> Result:
        """Return the decoded answer of one call.

        Raises
        ------
        ProblemError
            The service refused.
        ServiceUnavailableError
            No answer, or try later, after all attempts.
        """
        attempts = calls.Attempts(self._retries, self._first_wait_s, is_safe=call.is_safe)
        while True:
            try:
                return self._send_once(call)
            except ServiceUnavailableError as error:
                wait_s = attempts.wait_after(error)
            self._sleep(wait_s)

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
        headers : mapping, optional
            Of the request, such as ``Range``.
        on_status : callable
            Told the status before the first byte: 206 when a range is given.

        Raises
        ------
        ProblemError
            The service refused.
        ServiceUnavailableError
            No answer, or the answer broke off.
        """
        # None leaves the query that a path may carry
        query = {name: value for name, value in (params or {}).items() if value is not None} or None
        reported = {"Accept": "*/*", **(headers or {})}
        try:
            with self._http.stream("GET", calls.BASE_PATH + path, params=query, headers=reported) as response:
                if not response.is_success:
                    response.read()
                    raise error_of(response)
                on_status(response.status_code)
                yield from response.iter_bytes()
        except httpx.TransportError as error:
            raise calls.broke_off(path, error) from error

    def pages(self, path: str, params: Mapping[str, Any] | None = None, *, rows: str = "rows") -> Iterator[Json]:
        """Yield every row of a list below ``/api/v1``, page after page; ``rows`` names the field that holds them."""
        cursor: str | None = None
        while True:
            page = self.send(calls.page_of(path, params, cursor))
            yield from page[rows]
            cursor = page.get("next")
            if not cursor:
                return

    def follow(self, path: str, follower: calls.Follower) -> Iterator[calls.StreamEvent]:
        """Yield the events of a stream, through every end of the connection, until the follower has had enough.

        Raises
        ------
        ProblemError
            The service refused.
        ServiceUnavailableError
            The service did not come back in time.
        """
        while True:
            try:
                with closing(self._chunks(path, follower)) as chunks:
                    for chunk in chunks:
                        yield from follower.consume(chunk)
                fault = ServiceUnavailableError(f"the stream {path} ended")
            except ServiceUnavailableError as error:
                fault = error
            self._sleep(follower.wait_after(fault))

    def _chunks(self, path: str, follower: calls.Follower) -> Generator[bytes, None, None]:
        """Yield the events of one connection."""
        headers, timeout = follower.headers(), follower.timeout(self._http.timeout)
        try:
            with self._http.stream("GET", calls.BASE_PATH + path, headers=headers, timeout=timeout) as response:
                if not response.is_success:
                    response.read()
                    raise error_of(response)
                yield from response.iter_bytes()
        except httpx.TransportError as error:
            raise calls.no_answer(self._http.base_url, "GET", calls.BASE_PATH + path, error) from error

    def _send_once(self, call: calls.Call[Result]) -> Result:
        """Send once, and again where the key was refused, which did nothing, and another is stored by now."""
        try:
            response = self._respond(call)
            if response.status_code in _KEY_REFUSED and self._is_key_replaced():
                response = self._respond(call)
        except httpx.TransportError as error:
            raise calls.no_answer(self._http.base_url, call.method, call.url, error) from error
        answer: Result = calls.decoded(response, call.member)
        return answer

    def _respond(self, call: calls.Call[Result]) -> httpx.Response:
        return self._http.request(call.method, call.url, content=call.content, params=call.query, headers=call.headers)

    def _is_key_replaced(self) -> bool:
        """Take the stored key, and return whether it is another one."""
        headers = calls.default_headers(self._stored_key())
        is_another = headers.get("Authorization", "") not in {"", self._http.headers.get("Authorization")}
        self._http.headers.update(headers)
        return is_another
