"""Notes for the audit log: what a request is, said in the words of an entry."""

from dataclasses import replace
from hashlib import sha256

from starlette.types import Scope

from service.api.access.principals import Principal
from service.records.operations.access_key import without_secrets
from service.records.operations.audit import DONE, AuditContext, AuditEvent

BASE_PATH = "/api/v1"
SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
#: longest target kept; ids in paths are shorter
_TARGET_LENGTH = 200


def note_of(scope: Scope) -> AuditContext:
    """Return the note that the access layer gave a request."""
    note: AuditContext = scope["state"].setdefault("audit_note", AuditContext())
    return note


def digest_body(scope: Scope, body: bytes) -> None:
    """Put the digest of a request's body into its note; called before the body is acted upon."""
    note = note_of(scope)
    if note.audit_event is not None:
        note.audit_event = replace(note.audit_event, body_sha256=sha256(body).hexdigest())


def note_choice(scope: Scope, choice: str) -> None:
    """Put a choice that overrides a check into the target of a request's audit entry, as a query."""
    note = note_of(scope)
    if note.audit_event is not None:
        note.audit_event = replace(note.audit_event, target=f"{note.audit_event.target.rstrip('/')}?{choice}")


def audit_event_of(scope: Scope, at_us: int, outcome: str = DONE) -> AuditEvent:
    """Return the audit event of a request, also of a refused one.

    Parameters
    ----------
    scope : Scope
        Of the request; ``state.principal`` tells who asks.
    at_us : int
        The present, microseconds UTC.
    outcome : str
        ``done``, or the status of the refusal.
    """
    state = scope["state"]
    principal: Principal | None = state.get("principal")
    return AuditEvent(
        at_us=at_us,
        who=principal.name if principal else "anonymous",
        key_id=principal.key_id if principal else "",
        role=str(principal.role) if principal else "",
        address=address_of(scope),
        action=getattr(scope.get("route"), "name", None) or scope["method"],
        target=_target(scope),
        outcome=outcome,
        request_id=str(state.get("request_id", "")),
    )


def address_of(scope: Scope) -> str:
    """Return the address that a request came from; that behind a proxy only when the proxy is trusted."""
    client = scope.get("client")
    return str(client[0])[:64] if client else ""


def _target(scope: Scope) -> str:
    """Return the path below the base; one that ends with a slash takes the id of what is made."""
    path = without_secrets(scope["path"]).removeprefix(BASE_PATH).encode("ascii", "backslashreplace").decode("ascii")
    target = "".join(letter if letter.isprintable() else "?" for letter in path)[:_TARGET_LENGTH].rstrip("/")
    is_collection = scope["method"] in {"POST", "PUT"} and ":" not in target.rpartition("/")[2]
    return f"{target}/" if is_collection else target
