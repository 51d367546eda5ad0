"""Errors between a client and the service.

::

    ClientError
    |- ProblemError             the service answered with an RFC 9457 problem; sending the same again gives the same
    |- ServiceUnavailableError  no answer, or one that says try later (429, 5xx); sending the same again is right

The second carries ``retry_after_s`` when the service named a time.
"""

from typing import Any

import httpx

#: answers that ask for patience rather than for another request
TRY_LATER = frozenset({408, 425, 429, 500, 502, 503, 504})

#: faulty fields in the text of an error; ``errors`` has all that the service sent
_MOST_LISTED = 12


class ClientError(Exception):
    """Root of all errors of the client."""


class ProblemError(ClientError):
    """The service refused the request.

    Parameters
    ----------
    status : int
        HTTP status.
    code : str
        Stable machine-readable code, for example ``plan.unknown``.
    detail : str
        What the service said.
    request_id : str or None
        Names the request in the service's log.
    errors : tuple of dict
        The faulty fields: pointer, code, detail.
    next_step : str
        What to do next, as the service says it; empty where a proxy answered.
    """

    def __init__(
        self,
        status: int,
        code: str,
        detail: str,
        request_id: str | None = None,
        errors: tuple[dict[str, Any], ...] = (),
        next_step: str = "",
    ) -> None:
        where = f" (request {request_id})" if request_id else ""
        advice = f"\nNext: {next_step}" if next_step else ""
        super().__init__(f"{status} {code}: {detail}{where}{_listed(errors, detail)}{advice}")
        self.status = status
        self.code = code
        self.detail = detail
        self.request_id = request_id
        self.errors = errors
        self.next_step = next_step


class ServiceUnavailableError(ClientError):
    """The service cannot be reached or cannot answer now."""

    def __init__(self, detail: str, status: int | None = None, retry_after_s: float | None = None) -> None:
        super().__init__(detail)
        self.status = status
        self.retry_after_s = retry_after_s


def error_of(response: httpx.Response) -> ClientError:
    """Return the error that an answer outside 2xx stands for."""
    problem = _problem(response)
    code = str(problem.get("code") or f"http.{response.status_code}")
    detail = str(problem.get("detail") or problem.get("title") or response.reason_phrase)
    next_step = str(problem.get("next_step") or "")
    if response.status_code in TRY_LATER:
        # one line: it also stands in logs and in the reports of links
        text = f"{response.status_code} {code}: {detail}" + (f" Next: {next_step}" if next_step else "")
        return ServiceUnavailableError(text, response.status_code, _wait(response))
    request_id = problem.get("request_id") or response.headers.get("x-request-id")
    errors = problem.get("errors")
    return ProblemError(
        response.status_code,
        code,
        detail,
        str(request_id) if request_id else None,
        tuple(error for error in errors if isinstance(error, dict)) if isinstance(errors, list) else (),
        next_step,
    )


def _listed(errors: tuple[dict[str, Any], ...], detail: str) -> str:
    """Return the faulty fields, a line each; the first ones, and nothing that the detail says already."""
    lines = [f"\n  {each.get('pointer') or '/'}: {each.get('detail', '')}" for each in errors]
    if len(lines) == 1 and str(errors[0].get("detail")) in detail:
        pointer = str(errors[0].get("pointer") or "/")
        return "" if pointer in detail else f"\n  {pointer}"
    more = len(lines) - _MOST_LISTED
    return "".join(lines[:_MOST_LISTED]) + (f"\n  (and {more} more)" if more > 0 else "")


def _problem(response: httpx.Response) -> dict[str, Any]:
    """Return the problem document, empty when the answer is none (a proxy's page)."""
    try:
        document = response.json()
    except ValueError:
        return {}
    return document if isinstance(document, dict) else {}


def _wait(response: httpx.Response) -> float | None:
    """Return the seconds that ``Retry-After`` asks for, None without a plain number."""
    value = response.headers.get("retry-after", "")
    return float(value) if value.isdigit() else None
