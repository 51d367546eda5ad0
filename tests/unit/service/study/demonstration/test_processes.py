"""Child processes of a demonstration: a sign of life, a log, an end by their own id."""

import json
import os
import socket
import threading
import time
from typing import ClassVar

import pytest

from service.study.demonstration import processes
from service.study.demonstration.processes import ChildProcess, FrontEnd, ProcessFailedError

ANNOUNCE = 'import json, sys, time\nprint(json.dumps({"port": 17}), flush=True)\n'


@pytest.fixture
def start(tmp_path):
    """Return a starter of a module with some text, its log beside it."""

    def run(text, **options):
        (tmp_path / "story.py").write_text(text)
        environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
        return ChildProcess("the story", ["story"], tmp_path / "story.log", environment, **options)

    return run


def wait_for_end(process):
    deadline = time.monotonic() + 120.0
    while time.monotonic() < deadline:
        try:
            process.require_alive()
        except ProcessFailedError as error:
            return str(error)
        time.sleep(0.01)
    return "it did not end"


def test_the_first_line_is_its_announcement_and_a_stop_ends_it(start):
    with start(ANNOUNCE + "time.sleep(60)") as process:
        assert process.announcement == {"port": 17}
        process.require_alive()
        code = process.stop()
    # ended by SIGTERM; leaving the block stops it once more, which does nothing
    assert code == -15
    assert process.stop() == -15


def test_what_it_prints_later_does_not_block_it(start):
    with start(ANNOUNCE + 'print("x" * 500_000, flush=True)\nsys.exit(3)') as process:
        assert "the story ended with code 3" in wait_for_end(process)


def test_a_process_that_dies_before_its_sign_of_life_is_told_with_its_log(start):
    with pytest.raises(ProcessFailedError) as caught:
        start('raise SystemExit("no such analyzer")')
    assert "the story did not start; its log is" in str(caught.value)
    assert "no such analyzer" in str(caught.value)


def test_a_process_whose_first_line_is_no_json_is_ended_and_told(start):
    with pytest.raises(ProcessFailedError, match="said 'hello' in place of where it listens"):
        start('import time\nprint("hello", flush=True)\ntime.sleep(60)')


def test_a_process_without_announcement_writes_all_to_its_log(start):
    with start('print("at work", flush=True)\nraise SystemExit(4)', announces=False) as process:
        assert process.announcement == {}
        text = wait_for_end(process)
    assert "ended with code 4" in text
    assert "at work" in text


def test_one_that_does_not_listen_to_the_signal_is_killed(start, monkeypatch):
    monkeypatch.setattr("service.study.demonstration.processes._STOP_TIMEOUT_S", 0.3)
    text = "import signal\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\n" + ANNOUNCE + "time.sleep(60)"
    with start(text) as process:
        assert process.stop() == -9


def test_one_that_never_speaks_is_ended(start, monkeypatch):
    monkeypatch.setattr("service.study.demonstration.processes._READY_TIMEOUT_S", 0.3)
    with pytest.raises(ProcessFailedError, match="did not start"):
        start("import time\ntime.sleep(60)")


class Recorded:
    """A process that only notes how it was started."""

    started: ClassVar[list] = []

    def __init__(self, _name, arguments, log_path, _environment, *, announces):
        self.started.append((arguments, log_path.name, announces))

    def stop(self):
        self.started.append("stop")

    def require_alive(self):
        raise ProcessFailedError


def test_a_front_end_gets_task_source_and_log_of_its_own_each_time(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "ChildProcess", Recorded)
    Recorded.started.clear()
    heard = []
    with socket.create_server(("127.0.0.1", 0)) as analyzer:

        def answer():
            connection, _ = analyzer.accept()
            with connection:
                heard.append(connection.recv(64))
                connection.sendall(b"1\n")

        thread = threading.Thread(target=answer, daemon=True)
        thread.start()
        resource = f"TCPIP::127.0.0.1::{analyzer.getsockname()[1]}::SOCKET"
        with FrontEnd(tmp_path, resource, ["--json-log"], {}) as front_end:
            front_end.require_alive()  # there is none yet
            front_end.start({"id": "first"}, "sa-1")
            with pytest.raises(ProcessFailedError):
                front_end.require_alive()
            front_end.stop()
            assert not front_end.is_running
            thread.join(120)
            # the sweep that nobody waits for any more takes no row
            assert heard == [b":ABOR;*OPC?\n"]
            front_end.start({"id": "second"}, "sa-2")
    tasks = [tmp_path / "task.json", tmp_path / "task-2.json"]
    assert [json.loads(task.read_text())["id"] for task in tasks] == ["first", "second"]
    commands = [
        ["service", "acquire", "--task", str(task), "--source", source, "--resource", resource, "--json-log"]
        for task, source in zip(tasks, ("sa-1", "sa-2"), strict=True)
    ]
    assert Recorded.started == [
        (commands[0], "acquire.log", False),
        "stop",
        (commands[1], "acquire-2.log", False),
        # at its end the analyzer is not spoken to: it may have gone before
        "stop",
    ]
