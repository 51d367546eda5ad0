"""The writer goes on behind a group that is full."""

from threading import Event

from db.connection.engines import open_engines
from db.connection.writer import GROUP_LIMIT, Writer


def test_more_than_a_group_waiting_at_once_is_all_written_in_order(tmp_path):
    engines = open_engines(f"sqlite:///{tmp_path / 'soo.db'}")
    writer, released, written = Writer(engines.write), Event(), []
    blocking = writer.submit(lambda _connection: released.wait(60))
    waiting = [
        writer.submit(lambda _connection, number=number: number, written.append) for number in range(3 * GROUP_LIMIT)
    ]
    released.set()
    assert blocking.result(60)
    assert [future.result(60) for future in waiting] == list(range(3 * GROUP_LIMIT)) == written
    writer.close()
    engines.dispose()
