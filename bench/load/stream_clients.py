"""Clients of the stream benchmark as a process of its own: many connections, each counts what it gets.

Run ``python -m bench.load.stream_clients URL KEY SPACECRAFT CLIENTS``. It prints ``ready`` when all have their first
event, counts until its input ends and prints the counts of measurements by client as JSON.
"""

import asyncio
import json
import sys
from urllib.parse import urlsplit

_MARK = b"event: measurement\n"


async def main(url: str, key: str, spacecraft_id: str, clients: int) -> None:
    """Connect, count, print."""
    counts = [0] * clients
    readers = [asyncio.Event() for _ in range(clients)]
    tasks = [asyncio.create_task(_read(url, key, spacecraft_id, counts, k, readers[k])) for k in range(clients)]
    await asyncio.gather(*(ready.wait() for ready in readers))
    print("ready", flush=True)
    await asyncio.to_thread(sys.stdin.read)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    print(json.dumps(counts), flush=True)


async def _read(url: str, key: str, spacecraft_id: str, counts: list[int], position: int, ready: asyncio.Event) -> None:
    address = urlsplit(url)
    reader, writer = await asyncio.open_connection(address.hostname, address.port)
    path = f"/api/v1/spacecraft/{spacecraft_id}/stream"
    writer.write(f"GET {path} HTTP/1.1\r\nHost: bench\r\nAuthorization: Bearer {key}\r\n\r\n".encode())
    rest = b""
    try:
        while chunk := await reader.read(65536):
            ready.set()
            # a mark may be cut by the end of a chunk
            rest += chunk
            counts[position] += rest.count(_MARK)
            rest = rest[-(len(_MARK) - 1) :]
    finally:
        writer.close()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], sys.argv[2], sys.argv[3], int(sys.argv[4])))
