"""Storing what the chain computed, in the transaction that moves the consumer's head."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, zip_longest
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, Connection, Row, Table, select, tuple_, update

from db.connection.writer import insert_new
from db.database import lock_head
from db.encoding.measurement_runs import pack_carriers
from db.encoding.row_mapping import attitude_values, torque_values
from db.measurements.slow_inputs import store_inputs
from db.results.attitude_summaries import forget_days
from db.results.jobs import store_checkpoint
from db.results.replays import note_rows
from db.results.stored_rows import ResultSeries, sealed_keys
from db.schema.tables import attitude, head, torque
from service.ports import LIVE, Outcome
from service.records.levels.attitude import AttitudeRow, TorqueCommand
from service.records.storage import Checkpoint

#: key tuples in one query; SQLite before 3.32 binds 999 values at most
_LOOKUP_CHUNK = 250

Result = AttitudeRow | TorqueCommand
ResultKey = tuple[Any, ...]


class Consumed(NamedTuple):
    """Position of the consumer after the outcomes."""

    number: int
    epoch_us: int | None


def store_outcomes(
    connection: Connection,
    key: int,
    version: str,
    outcomes: Sequence[Outcome],
    consumed: Consumed,
    checkpoint: Checkpoint | None = None,
) -> int:
    """Store outcomes and return the last result sequence; runs in the writer's transaction."""
    state = lock_head(connection, key)
    if version != LIVE:
        fresh = _not_sealed(connection, key, version, list(_results(outcomes)))
        inserted = _insert(connection, key, version, [(result, None) for result in fresh], _carriers(outcomes))
        note_rows(connection, key, version, *inserted, checkpoint)
        return int(state.result_sequence)
    results = list(_results(outcomes))
    fresh = results if _are_new(results, state.consumed_number) else _fresh(connection, key, version, results)
    numbered = list(zip(fresh, range(state.result_sequence + 1, 1 << 62), strict=False))
    _insert(connection, key, version, numbered, _carriers(outcomes))
    forget_days(connection, key, state.consumed_epoch_us, (result.epoch_us for result in fresh))
    applied = [outcome.applied for outcome in outcomes if outcome.applied is not None]
    if applied:
        store_inputs(connection, key, applied)
    if checkpoint is not None:
        store_checkpoint(connection, key, checkpoint)
    sequence = int(state.result_sequence) + len(fresh)
    _advance(connection, key, state, consumed, sequence)
    return sequence


def _results(outcomes: Sequence[Outcome]) -> Iterator[Result]:
    for outcome in outcomes:
        yield from outcome.rows
        if outcome.command is not None:
            yield outcome.command


def _key_of(result: Result) -> ResultKey:
    position = (result.epoch_us, result.number)
    return (result.method.value, *position) if isinstance(result, AttitudeRow) else position


def _are_new(results: list[Result], consumed_number: int) -> bool:
    """Return whether no result is stored yet: results go in together with the consumer's position, each once."""
    is_beyond = all(result.number > consumed_number for result in results)
    return is_beyond and len(set(map(_key_of, results))) == len(results)


def _fresh(connection: Connection, key: int, version: str, results: list[Result]) -> list[Result]:
    """Return those results that are not stored yet, each once."""
    rows = [_key_of(result) for result in results if isinstance(result, AttitudeRow)]
    commands = [_key_of(result) for result in results if isinstance(result, TorqueCommand)]
    columns = (attitude.c.method, attitude.c.epoch_us, attitude.c.number)
    seen = set(_stored(connection, key, version, attitude, columns, rows))
    seen |= set(_stored(connection, key, version, torque, (torque.c.epoch_us, torque.c.number), commands))
    fresh: list[Result] = []
    for result in results:
        name = _key_of(result)
        if name not in seen:
            seen.add(name)
            fresh.append(result)
    return _not_sealed(connection, key, version, fresh)


def _not_sealed(connection: Connection, key: int, version: str, results: list[Result]) -> list[Result]:
    """Return those results that no segment holds."""
    wanted: dict[str | None, list[tuple[int, int]]] = {}
    for result in results:
        wanted.setdefault(_method_of(result), []).append((result.epoch_us, result.number))
    sealed = {
        method: sealed_keys(
            connection, ResultSeries(key, torque if method is None else attitude, version, method), keys
        )
        for method, keys in wanted.items()
    }
    if not any(sealed.values()):
        return results
    return [result for result in results if (result.epoch_us, result.number) not in sealed[_method_of(result)]]


def _method_of(result: Result) -> str | None:
    return result.method.value if isinstance(result, AttitudeRow) else None


def _stored(
    connection: Connection,
    key: int,
    version: str,
    table: Table,
    columns: tuple[ColumnElement[Any], ...],
    wanted: list[ResultKey],
) -> Iterator[ResultKey]:
    """Yield those of the wanted keys that a table holds."""
    for start in range(0, len(wanted), _LOOKUP_CHUNK):
        query = select(*columns).where(
            table.c.spacecraft_key == key,
            table.c.version == version,
            tuple_(*columns).in_(wanted[start : start + _LOOKUP_CHUNK]),
        )
        yield from (tuple(row) for row in connection.execute(query))


def _carriers(outcomes: Sequence[Outcome]) -> dict[ResultKey, bytes | None]:
    """Return what is stored of the carriers, by row; of a row that was run again it is that of the first time."""
    # as the row itself: an alignment may run rows again whose results stand already
    each = (zip_longest(outcome.rows, outcome.carriers) for outcome in reversed(outcomes))
    found = chain.from_iterable(each)
    return {_key_of(row): None if results is None else pack_carriers(results) for row, results in found}


def _insert(
    connection: Connection,
    key: int,
    version: str,
    numbered: Sequence[tuple[Result, int | None]],
    carriers: Mapping[ResultKey, bytes | None],
) -> tuple[int, int]:
    """Insert results and return how many rows of attitude and of torque were new."""
    rows: list[dict[str, Any]] = []
    commands: list[dict[str, Any]] = []
    for result, sequence in numbered:
        if isinstance(result, AttitudeRow):
            rows.append({**attitude_values(key, version, result, sequence), "carriers": carriers.get(_key_of(result))})
        else:
            commands.append(torque_values(key, version, result, sequence))
    return insert_new(connection, attitude, rows), insert_new(connection, torque, commands)


def _advance(connection: Connection, key: int, state: Row[Any], consumed: Consumed, sequence: int) -> None:
    """Move the consumer's head, never back."""
    epochs_us = [epoch_us for epoch_us in (state.consumed_epoch_us, consumed.epoch_us) if epoch_us is not None]
    connection.execute(
        update(head)
        .where(head.c.spacecraft_key == key)
        .values(
            consumed_number=max(state.consumed_number, consumed.number),
            consumed_epoch_us=max(epochs_us, default=None),
            result_sequence=sequence,
        )
    )
