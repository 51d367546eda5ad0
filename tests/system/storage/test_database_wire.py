"""Connections that pass through others to the database server: lost notifications, and poolers that are refused."""

import shutil
import socket
import tempfile
import threading
import time
from collections import deque
from contextlib import contextmanager, suppress
from pathlib import Path

import chaos_clients as chaos
import pytest
from sqlalchemy.engine import make_url

pytestmark = [pytest.mark.system, pytest.mark.slow]

KEY = "a-key-for-tests-only"
SEED = 29
#: types of messages of PostgreSQL's protocol 3
NOTIFICATION, READY, TERMINATE, QUERY, SYNC = b"A", b"Z", b"X", b"Q", b"S"
IDLE = b"I"


def read_message(sender, *, is_first=False):
    """Read a message: type (none of the first of a client), length, content; return None at the end."""
    size = 4 if is_first else 5
    head = sender.recv(size, socket.MSG_WAITALL)
    rest = int.from_bytes(head[-4:]) - 4
    return None if len(head) < size else head + (sender.recv(rest, socket.MSG_WAITALL) if rest else b"")


class Wire:
    """A socket of a database server whose clients are passed on to another one.

    Parameters
    ----------
    url : str
        The server, on a Unix socket.
    """

    def __init__(self, url):
        self._target = f"{make_url(url).query['host']}/.s.PGSQL.5432"
        self._folder = Path(tempfile.mkdtemp(prefix="soo-wire-"))
        self.url = make_url(url).set(query={"host": str(self._folder)}).render_as_string()
        self._server = socket.socket(socket.AF_UNIX)
        self._server.bind(f"{self._folder}/.s.PGSQL.5432")
        self._server.listen()
        self._open = [self._server]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self):
        for each in self._open:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()
        shutil.rmtree(self._folder)

    def connected(self):
        """Return a connection to the server."""
        session = socket.socket(socket.AF_UNIX)
        session.connect(self._target)
        self._open.append(session)
        return session

    def _accept(self):
        with suppress(OSError):
            while True:
                client, _ = self._server.accept()
                self._open.append(client)
                threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client):
        with suppress(OSError, ValueError):
            self.serve(client)
        with suppress(OSError):
            client.shutdown(socket.SHUT_RDWR)


class DeafWire(Wire):
    """A wire on which no notification arrives."""

    lost = 0

    def serve(self, client):
        session = self.connected()
        threading.Thread(target=self._answer, args=(session, client), daemon=True).start()
        session.sendall(read_message(client, is_first=True) or b"")
        while message := read_message(client):
            session.sendall(message)
        session.shutdown(socket.SHUT_WR)

    def _answer(self, session, client):
        with suppress(OSError, ValueError):
            while message := read_message(session):
                if message[:1] == NOTIFICATION:
                    self.lost += 1
                else:
                    client.sendall(message)
            client.shutdown(socket.SHUT_RDWR)


class TransactionPooler(Wire):
    """A pooler that gives a session of the server to each transaction: the one used last, or each in turn."""

    is_newest_first = True

    def __init__(self, url):
        self._idle = deque()
        self._changed = threading.Condition()
        super().__init__(url)

    def serve(self, client):
        session = self.connected()
        session.sendall(read_message(client, is_first=True) or b"")
        ready = self._pass_on(session, client)
        self._release(session)
        client.sendall(ready)
        held = None
        while (message := read_message(client)) and message[:1] != TERMINATE:
            held = held or self._acquire()
            held.sendall(message)
            if message[:1] in (QUERY, SYNC):
                ready = self._pass_on(held, client)
                if ready[-1:] == IDLE:
                    self._release(held)
                    held = None
                client.sendall(ready)

    def _acquire(self):
        with self._changed:
            self._changed.wait_for(lambda: self._idle)
            return self._idle.pop() if self.is_newest_first else self._idle.popleft()

    def _release(self, session):
        with self._changed:
            self._idle.append(session)
            self._changed.notify()

    def _pass_on(self, session, client):
        """Pass on what the server answers until it is ready; return that message, which has the transaction's state."""
        while message := read_message(session):
            if message[:1] == READY:
                return message
            client.sendall(message)
        raise ConnectionAbortedError


class PoolerInTurn(TransactionPooler):
    is_newest_first = False


@contextmanager
def between(kind, url):
    wire = kind(url)
    try:
        yield wire
    finally:
        wire.close()


def test_rows_whose_announcement_is_lost_are_found_by_the_poll(start_service, spacecraft, carriers, durable_url):
    print(f"seed {SEED}")
    with between(DeafWire, durable_url) as wire:
        leading = start_service("--port", "0", "--clock", "data", "--database", wire.url)
        with leading.client() as client:
            plan_id = chaos.set_up(client, spacecraft, carriers)
        other = start_service("--port", "0", "--clock", "data", "--database", durable_url)
        address = other.url
        assert "another service leads" in other.written()
        sender = chaos.ChaosClient(address, KEY, plan_id, 0, 2, SEED)
        sender.start()
        time.sleep(3.0)
        chaos.finish([sender])
        promised = chaos.promised([sender])
        with leading.client() as client:
            chaos.await_consumed(client, promised)
            print(chaos.compare(client, promised), f"{wire.lost} announcements lost")
        assert wire.lost > 0
        assert [service.end()[0] for service in (other, leading)] == [0, 0]


@pytest.mark.parametrize("kind", [TransactionPooler, PoolerInTurn])
def test_a_pooler_that_changes_sessions_is_refused(refused_starts, durable_url, kind):
    with between(kind, durable_url) as wire:
        ((code, said),) = refused_starts((["--port", "0", "--database", wire.url], {"SOO_BOOTSTRAP_KEY": KEY}))
    print(said)
    assert code == 2
    assert "let the pooler run in session mode, or connect to the server itself" in said
