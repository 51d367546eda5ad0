"""A service that only records: it keeps the contract's promise for rows, and misbehaves on demand.

It knows a row by its epoch, and what it has taken once is a duplicate the second time.
"""

import json
import socket
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any


def reply_beside_rows(body: dict[str, Any]) -> dict[str, Any]:
    """Return the answer to evidence traces, which are all new, and to reports of links, of which nothing is wanted."""
    if "traces" in body:
        return {"received": len(body["traces"]), "accepted": len(body["traces"]), "duplicates": 0}
    return {"links": [{"id": each["id"], "enabled": True, "reset": 0} for each in body["links"]]}


class Recorder:
    """A service that keeps rows by epoch and misbehaves on demand."""

    def __init__(self, carriers: list[str]) -> None:
        self.carriers = carriers
        self.rows: dict[str, dict[str, Any]] = {}
        self.duplicates = 0
        self.conflicts = 0
        self.seqs: list[tuple[int, int]] = []
        self.faults: list[str] = []
        #: of a slow answer; longer than the client waits
        self.slow_s = 0.8
        self.lock = threading.Lock()
        self.port = 0
        self._server: ThreadingHTTPServer | None = None
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Listen, the second time on the same port."""
        recorder = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"
            timeout = 5.0
            # Two writes an answer wait for the client's delayed acknowledgement without this.
            disable_nagle_algorithm = True

            def do_GET(self) -> None:
                recorder.answer(self, 200, {"plan_id": 1, "carriers": [{"id": each} for each in recorder.carriers]})

            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["content-length"])))
                if "measurements" in body:
                    recorder.consume(self, body)
                else:
                    recorder.answer(self, 200, reply_beside_rows(body))

            def log_message(self, *_: Any) -> None:
                """Stay silent."""

        class Server(ThreadingHTTPServer):
            daemon_threads = True
            allow_reuse_address = True

        self._server = Server(("127.0.0.1", self.port), Handler)
        self.port = self._server.server_port
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.01})
        self._thread.start()

    def stop(self) -> None:
        """Stop listening; open connections end with their next answer."""
        if self._server is not None and self._thread is not None:
            self.faults.insert(0, "drop")
            self._server.shutdown()
            self._server.server_close()
            self._thread.join()
            self._server = None

    def consume(self, handler: BaseHTTPRequestHandler, body: dict[str, Any]) -> None:
        """Store a batch, before or instead of the armed fault."""
        with self.lock:
            fault = self.faults.pop(0) if self.faults else ""
            if fault not in {"drop", "500", "slow"}:
                reply = self._store(body)
            if fault in {"500", "stored_500"}:
                self.answer(handler, 500, {"code": "internal", "detail": "armed"})
            elif fault in {"drop", "stored_drop"}:
                handler.close_connection = True
                handler.connection.shutdown(socket.SHUT_RDWR)
            elif fault == "slow":
                time.sleep(self.slow_s)
                handler.close_connection = True
            else:
                self.answer(handler, 200, reply)

    def _store(self, body: dict[str, Any]) -> dict[str, Any]:
        accepted = duplicates = 0
        for each in body["measurements"]:
            if each["epoch"] not in self.rows:
                self.rows[each["epoch"]] = each
                accepted += 1
            elif self.rows[each["epoch"]] == each:
                duplicates += 1
            else:
                self.conflicts += 1
        self.duplicates += duplicates
        self.seqs.append((body["first_seq"], len(body["measurements"])))
        return {"accepted": accepted, "duplicates": duplicates, "late": 0, "refused": []}

    def answer(self, handler: BaseHTTPRequestHandler, status: int, document: dict[str, Any]) -> None:
        """Send one JSON answer."""
        content = json.dumps(document).encode()
        handler.send_response(status)
        handler.send_header("content-type", "application/json")
        handler.send_header("content-length", str(len(content)))
        handler.end_headers()
        handler.wfile.write(content)
