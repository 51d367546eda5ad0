"""Requests to the service inside an event loop: as `service.client.transport`, awaited."""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Mapping
from contextlib import aclosing
from typing import Any, Self, TypeVar

import httpx

from service.client import call as calls
from service.client.documents import Json
from service.client.problem import ServiceUnavailableError, error_of

Result = TypeVar("Result")


class AsyncTransport:
    """Send requests with one key to one service; parameters are those of `service.client.transport.Transport`."""

    def __init__(
        self,
        service_url: str,
        key: str | None = None,
        *,
        timeout_s: float = 10.0,
        retries: int = 3,
        http: httpx.AsyncBaseTransport | None = None,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
        first_wait_s: float = 0.5,
    ) -> None:
        self._http = httpx.AsyncClient(
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

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connections."""
        await self._http.aclose()

    async def request(
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
        return await self.send(call)

    async def send(self, call: calls.Call[Result]) -> Result:
        """Return the decoded answer of one call; errors as in `service.client.transport.Transport.send`."""
        attempts = calls.Attempts(self._retries, self._first_wait_s, is_safe=call.is_safe)
        while True:
            try:
                return await self._send_once(call)
            except ServiceUnavailableError as error:
                wait_s = attempts.wait_after(error)
            await self._sleep(wait_s)

    async def download(self, path: str, params: Mapping[str, Any] | None = None) -> AsyncIterator[bytes]:
        """Yield the body of a GET as it comes; see `service.client.transport.Transport.download`."""
        query = {name: value for name, value in (params or {}).items() if value is not None}
        try:
            async with self._http.stream(
                "GET", calls.BASE_PATH + path, params=query, headers={"Accept": "*/*"}
            ) as response:
                if not response.is_success:
                    await response.aread()
                    raise error_of(response)
                async for chunk in response.aiter_bytes():
                    yield chunk
        except httpx.TransportError as error:
            raise calls.broke_off(path, error) from error

    async def pages(
        self, path: str, params: Mapping[str, Any] | None = None, *, rows: str = "rows"
    ) -> AsyncIterator[Json]:
        """Yield every row of a list below ``/api/v1``, page after page; ``rows`` names the field that holds them."""
        cursor: str | None = None
        while True:
            page = await self.send(calls.page_of(path, params, cursor))
            for row in page[rows]:
                yield row
            cursor = page.get("next")
            if not cursor:
                return

    async def follow(self, path: str, follower: calls.Follower) -> AsyncIterator[calls.StreamEvent]:
        """Yield the events of a stream; see `service.client.transport.Transport.follow`."""
        while True:
            try:
                async with aclosing(self._chunks(path, follower)) as chunks:
                    async for chunk in chunks:
                        for event in follower.consume(chunk):
                            yield event
                fault = ServiceUnavailableError(f"the stream {path} ended")
            except ServiceUnavailableError as error:
                fault = error
            await self._sleep(follower.wait_after(fault))

    async def _chunks(self, path: str, follower: calls.Follower) -> AsyncGenerator[bytes, None]:
        """Yield the events of one connection."""
        headers, timeout = follower.headers(), follower.timeout(self._http.timeout)
        try:
            async with self._http.stream("GET", calls.BASE_PATH + path, headers=headers, timeout=timeout) as response:
                if not response.is_success:
                    await response.aread()
                    raise error_of(response)
                async for chunk in response.aiter_bytes():
                    yield chunk
        except httpx.TransportError as error:
            raise calls.no_answer(self._http.base_url, "GET", calls.BASE_PATH + path, error) from error

    async def _send_once(self, call: calls.Call[Result]) -> Result:
        try:
            response = await self._http.request(
                call.method, call.url, content=call.content, params=call.query, headers=call.headers
            )
        except httpx.TransportError as error:
            raise calls.no_answer(self._http.base_url, call.method, call.url, error) from error
        answer: Result = calls.decoded(response, call.member)
        return answer
