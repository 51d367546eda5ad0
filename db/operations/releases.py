"""State, commands and uplink products of the release of torques; implements ``service.ports.Releases``."""

from sqlalchemy import ColumnElement, Connection, and_, select, update

from db.columns import sound_rows
from db.database import Repository, lock_head, page_of
from db.encoding.record_codec import decode, encode
from db.measurements.archive import store_inputs
from db.tables import release_command, release_state, spacecraft, uplink_product
from service.errors import ConflictError, NotFoundError
from service.ports.archive import ListPart
from service.records.operations.release import Command, ProductForm, ReleaseChange, StoredRelease, UplinkProduct


class SqlReleases(Repository):
    """Releases in a relational database."""

    def stored(self, spacecraft_id: str) -> StoredRelease:
        """Return the newest state; version 0 and an empty document before the first."""
        key = self._database.key(spacecraft_id)
        row = self._database.fetch_one(select(release_state).where(release_state.c.spacecraft_key == key))
        return StoredRelease() if row is None else StoredRelease(int(row.version), row.document, row.holder)

    def versions(self) -> dict[str, int]:
        """Return the version of the newest state of each spacecraft that has one."""
        is_its_state = release_state.c.spacecraft_key == spacecraft.c.spacecraft_key
        rows = self._database.fetch(select(spacecraft.c.id, release_state.c.version).where(is_its_state))
        return dict(map(tuple, rows))

    def save(self, spacecraft_id: str, version: int, change: ReleaseChange) -> int:
        """Store a change in one transaction and return its version; ConflictError ``release.changed``."""
        key = self._database.key(spacecraft_id)

        def store(connection: Connection) -> int:
            # the head keeps every other writer of this spacecraft away, of this process and of any other
            lock_head(connection, key)
            _swap(connection, key, version, change)
            for command in change.commands:
                _store_command(connection, key, command)
            for product in change.products:
                _store_product(connection, key, product)
            if change.entries and store_inputs(connection, key, change.entries).accepted != len(change.entries):
                raise _changed(f"journal entries of version {version + 1} are there already")
            return version + 1

        return self._database.write(self._database.leases.under(store, spacecraft_id), key)

    def command(self, spacecraft_id: str, counter: int) -> Command:
        """Return one command; NotFoundError ``command.unknown``."""
        key = self._database.key(spacecraft_id)
        row = self._database.fetch_one(select(release_command.c.document).where(_is_command(key, counter)))
        if row is None:
            raise NotFoundError("command.unknown", f"There is no command {counter} of this spacecraft.")
        return decode(Command, row.document)

    def commands(self, spacecraft_id: str, part: ListPart) -> list[Command]:
        """Return commands prepared in a window in order of (prepared, counter) beyond a cursor."""
        prepared, counter = release_command.c.prepared_us, release_command.c.counter
        query = select(release_command.c.document).where(
            release_command.c.spacecraft_key == self._database.key(spacecraft_id)
        )
        rows = self._database.fetch(page_of(query, prepared, counter, part))
        return [decode(Command, row.document) for row in rows]

    def product(self, spacecraft_id: str, form: ProductForm, counter: int) -> UplinkProduct:
        """Return one uplink product; NotFoundError ``uplink.unknown``."""
        key = self._database.key(spacecraft_id)
        rows = self._database.fetch(select(uplink_product).where(_is_product(key, form, counter)))
        if not rows:
            raise NotFoundError("uplink.unknown", f"There is no uplink product {counter} with {form.value}.")
        return decode(UplinkProduct, sound_rows(uplink_product, rows)[0].document)

    def newest_product(self, spacecraft_id: str, form: ProductForm) -> UplinkProduct | None:
        """Return the product of a form with the greatest counter."""
        table = uplink_product
        query = select(table).where(
            table.c.spacecraft_key == self._database.key(spacecraft_id), table.c.form == form.value
        )
        rows = sound_rows(table, self._database.fetch(query.order_by(table.c.counter.desc()).limit(1)))
        return decode(UplinkProduct, rows[0].document) if rows else None


def _swap(connection: Connection, key: int, version: int, change: ReleaseChange) -> None:
    """Put a state in the place of the version given, ConflictError where another one is stored."""
    values = {"version": version + 1, "holder": change.holder, "document": change.document}
    found = connection.scalar(select(release_state.c.version).where(release_state.c.spacecraft_key == key))
    if (found or 0) != version:
        raise _changed(f"version {found} is stored, not {version}")
    if found is None:
        connection.execute(release_state.insert().values(spacecraft_key=key, **values))
    else:
        connection.execute(update(release_state).where(release_state.c.spacecraft_key == key).values(values))


def _store_command(connection: Connection, key: int, command: Command) -> None:
    """Store a command, new or changed; what was prepared under a counter never becomes something else."""
    is_it = _is_command(key, command.counter)
    digest = connection.scalar(select(release_command.c.digest).where(is_it))
    values = {"state": command.state.value, "document": encode(command)}
    if digest is None:
        whole = {"spacecraft_key": key, "counter": command.counter, "prepared_us": command.prepared_us, **values}
        connection.execute(release_command.insert().values(digest=command.digest, **whole))
    elif digest == command.digest:
        connection.execute(update(release_command).where(is_it).values(values))
    else:
        raise _changed(f"another command {command.counter} is stored")


def _store_product(connection: Connection, key: int, product: UplinkProduct) -> None:
    """Add a product; one that exists is never changed."""
    is_it = _is_product(key, product.form, product.counter)
    if connection.scalar(select(uplink_product.c.counter).where(is_it)) is not None:
        raise _changed(f"an uplink product {product.counter} with {product.form.value} is stored")
    values = {"form": product.form.value, "counter": product.counter, "created_us": product.created_us}
    connection.execute(uplink_product.insert().values(spacecraft_key=key, document=encode(product), **values))


def _is_command(key: int, counter: int) -> ColumnElement[bool]:
    return and_(release_command.c.spacecraft_key == key, release_command.c.counter == counter)


def _is_product(key: int, form: ProductForm, counter: int) -> ColumnElement[bool]:
    table = uplink_product
    return and_(table.c.spacecraft_key == key, table.c.form == form.value, table.c.counter == counter)


def _changed(what: str) -> ConflictError:
    return ConflictError("release.changed", f"Somebody else has changed the release of torques: {what}.")
