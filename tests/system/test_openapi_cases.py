"""Cases made from the OpenAPI document, good ones and bad ones, with every role, against a service over a real socket.

No answer is a 5xx, every status, content type and body is what the document says. Five hundred cases in continuous
integration, ten thousand in the nightly one; the seed is printed and can be given as SOO_CASES_SEED.
"""

import contextlib
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest
import requests
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded
from hypothesis import strategies as st
from hypothesis.errors import Unsatisfiable
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from service.records.operations.access import Role

pytestmark = pytest.mark.system
KEY = "a-key-for-tests-only"
CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
]
#: an answer that never ends is asked for with unknown spacecraft only
ENDLESS = "/api/v1/spacecraft/{spacecraft_id}/stream"
#: a key of each role and none; the first ones, which are drawn most often, get furthest in
ROLES = (*map(str, reversed(Role)), Role.ADMIN.value, "")
MODES = (schemathesis.GenerationMode.POSITIVE, schemathesis.GenerationMode.NEGATIVE)
#: rates would hold up the flood of cases; no limit
NO_RATES = {f"SOO_RATE_LIMIT__{each}_PER_S": "0" for each in ("INGEST", "READ", "EXPORT", "CONTROL", "ANONYMOUS")}


@dataclass
class Field:
    """A service with something in it, and what has been asked of it."""

    url: str
    keys: Mapping[str, str]
    #: names that lead somewhere, put in place of invented ones in half of the cases
    names: Mapping[str, Any]
    asked: Counter[tuple[str, int]] = field(default_factory=Counter)
    session: requests.Session = field(default_factory=requests.Session)

    def ask(self, case: Any, role: str, *, is_known: bool) -> None:
        """Send one case with the key of a role and hold the answer against the document."""
        if is_known and case.path != ENDLESS:
            for name in self.names.keys() & set(case.path_parameters or {}):
                case.path_parameters[name] = self.names[name]
        headers = {"Authorization": f"Bearer {self.keys[role]}"} if role else {}
        answer = case.call(base_url=self.url, session=self.session, headers=headers, timeout=120)
        self.asked[role, answer.status_code] += 1
        case.validate_response(answer, checks=CHECKS)


def rows(count: int) -> list[dict[str, Any]]:
    """Return rows of sixteen powers, a minute apart."""
    return [
        {"epoch": f"2026-11-21T{k // 60:02d}:{k % 60:02d}:00.000000Z", "power_dbm": [-40.0 - k / 64] * 16}
        for k in range(count)
    ]


@pytest.fixture
def filled(serving: Any, tmp_path: Path, spacecraft: dict[str, Any], carriers: list[dict[str, Any]]) -> Iterator[Field]:
    """A service with a spacecraft, a plan, rows, an operation, a link and a key of each role."""
    with serving(tmp_path / "soo.db", **NO_RATES) as service, service.client() as client:
        yield fill(client, service.url, spacecraft, carriers)
        assert service.process.poll() is None, service.written()[-5000:]


def fill(client: httpx.Client, url: str, spacecraft: dict[str, Any], carriers: list[dict[str, Any]]) -> Field:
    """Put something into a service."""
    base = "/api/v1/spacecraft"
    client.post(base, json=spacecraft).raise_for_status()
    plan = client.put(f"{base}/sim-1/carriers", json={"carriers": carriers}).raise_for_status().json()
    batch = {"plan_id": plan["plan_id"], "source": "sa-1", "first_seq": 1, "measurements": rows(200)}
    client.post(f"{base}/sim-1/measurements:batch", json=batch).raise_for_status()
    window = {"start": "2026-11-21T01:00:00Z", "stop": "2026-11-21T02:00:00Z"}
    client.post(f"{base}/sim-1/operations", json={"kind": "eclipse", **window}).raise_for_status()
    link = {"id": "sa-1", "kind": "analyzer", "spacecraft_id": "sim-1", "source": "sa-1", "state": "MEASURE"}
    client.post("/api/v1/links:report", json={"links": [link]}).raise_for_status()
    keys = {
        str(role): client.post("/api/v1/keys", json={"name": role, "role": role}).raise_for_status().json()["key"]
        for role in Role
    }
    names = {"spacecraft_id": "sim-1", "link_id": "sa-1", "source": "sa-1", "operation_id": 1, "series": "measurements"}
    return Field(url, keys, names)


def run(filled: Field, cases: int, seed: int) -> None:
    """Ask so many cases, spread evenly over operations and kinds of cases."""
    operations = operations_of(httpx.get(f"{filled.url}/openapi.json", trust_env=False, timeout=120).json())
    each = -(-cases // (len(operations) * len(MODES)))
    for number, operation in enumerate(operations):
        for mode in MODES:
            # an operation without parameters and body cannot be asked wrongly
            with contextlib.suppress(Unsatisfiable):
                probe(filled, operation, mode, each, seed + number)()


def operations_of(document: dict[str, Any]) -> list[Any]:
    """Return the operations of a document; without its keys, or keys would be invented in place of those that hold."""
    for path in document["paths"].values():
        for operation in path.values():
            operation.pop("security", None)
    document["components"].pop("securitySchemes")
    return [result.ok() for result in schemathesis.openapi.from_dict(document).get_all_operations()]


def probe(filled: Field, operation: Any, mode: Any, cases: int, seed: int) -> Callable[[], None]:
    """Return the test of one operation."""

    @seeded(seed)
    @settings(
        max_examples=cases,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
        print_blob=False,
    )
    @given(
        case=operation.as_strategy(generation_mode=mode),
        role=st.sampled_from(ROLES),
        is_known=st.booleans(),
    )
    def ask(case: Any, role: str, is_known: bool) -> None:
        filled.ask(case, role, is_known=is_known)

    return ask


def check(filled: Field, cases: int, seed: int) -> None:
    """Run cases and tell what was asked."""
    seed = int(os.environ.get("SOO_CASES_SEED", seed))
    print(f"seed {seed}")
    run(filled, cases, seed)
    total = sum(filled.asked.values())
    by_status: Counter[int] = Counter()
    for (_, status), times in filled.asked.items():
        by_status[status] += times
    print(f"{total} cases: " + ", ".join(f"{times} x {status}" for status, times in sorted(by_status.items())))
    assert total >= 0.8 * cases
    assert {role for role, _ in filled.asked} == {"", *map(str, Role)}
    # they reach the inside: not only refusals
    assert by_status[200] > cases / 50


@pytest.mark.slow
def test_five_hundred_cases_are_answered_as_the_document_says(filled):
    check(filled, 500, 20_261_122)


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_ten_thousand_cases_are_answered_as_the_document_says(filled):
    check(filled, 10_000, 5)
