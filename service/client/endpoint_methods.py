"""Decorators that make a request, given as a value, a method of the blocking client and of the awaiting one."""

from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Mapping
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, overload

from service.client.async_transport import AsyncTransport
from service.client.call import Call
from service.client.event_lines import Follower
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
