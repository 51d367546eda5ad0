"""Change port: lines of `world_changes` over TCP; each is answered by one line, and clients come and go.

{"type":"changed","change":..,"carrier":..,"from":..,"until":..}
{"type":"error","detail":..}                                        nothing was changed
"""

import asyncio
import json
from contextlib import suppress
from typing import Any

from analyzer_sim.epochs import rfc3339
from analyzer_sim.plant.flown_world import FlownWorld
from analyzer_sim.plant.world_changes import MAX_LINE_BYTES, ChangeError


async def serve_changes(flown: FlownWorld, host: str, port: int) -> asyncio.Server:
    """Open the port; 0 takes a free one.

    Raises
    ------
    OSError
        It is taken.
    """

    async def on_connection(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        # the loop cancels connections when the simulator stops; asyncio's own callback would report that as an error
        with suppress(asyncio.CancelledError, ConnectionError):
            try:
                while line := await reader.readline():
                    await _send(writer, _answer(flown, line))
            except ValueError:
                await _send(writer, {"type": "error", "detail": f"a line holds at most {MAX_LINE_BYTES} bytes"})
            writer.close()

    return await asyncio.start_server(on_connection, host, port, limit=MAX_LINE_BYTES)


def _answer(flown: FlownWorld, line: bytes) -> dict[str, Any]:
    """Change the world and return the answer."""
    try:
        change = flown.change(line.decode("utf-8", errors="replace"))
    except ChangeError as error:
        return {"type": "error", "detail": str(error)}
    span = {"from": rfc3339(change.start_us), "until": rfc3339(change.stop_us)}
    return {"type": "changed", "change": change.kind.value, "carrier": change.carrier or None, **span}


async def _send(writer: asyncio.StreamWriter, message: dict[str, Any]) -> None:
    writer.write(json.dumps(message).encode() + b"\n")
    await writer.drain()
