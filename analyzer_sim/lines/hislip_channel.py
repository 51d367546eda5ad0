"""One of the two connections of a HiSLIP session: messages in, messages out. No state of the session."""

import asyncio
from collections.abc import AsyncGenerator

from analyzer_sim.lines.faulty_line import FaultyLine
from analyzer_sim.lines.hislip_messages import Decoder, FatalProtocolError, Message, MessageType, encode
from analyzer_sim.lines.hislip_session import RefusedMessageError
from analyzer_sim.lines.line_faults import LineFaults

_READ_BYTES = 1 << 16


class Channel:
    """One of the two connections of a session."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, faults: LineFaults) -> None:
        self._reader = reader
        self._writer = writer
        self._decoder = Decoder()
        self.line = FaultyLine(writer, faults)

    async def messages(self) -> AsyncGenerator[Message, None]:
        """Give the messages of the peer until it leaves."""
        while data := await self._reader.read(_READ_BYTES):
            for message in self._decoder.feed(data):
                yield message

    def put(self, kind: MessageType, control: int = 0, parameter: int = 0, payload: bytes = b"") -> None:
        """Send a message without waiting until it has left."""
        if not self._writer.is_closing():
            self._writer.write(encode(kind, control, parameter, payload))

    async def drain(self) -> None:
        """Wait until all that was put has left."""
        await self._writer.drain()

    def refuse(self, refusal: RefusedMessageError) -> None:
        """Tell the peer that one message was refused."""
        self.put(MessageType.ERROR, refusal.code, 0, refusal.text.encode())

    def end(self, error: FatalProtocolError) -> None:
        """Tell the peer why the session is over and close the connection."""
        self.put(MessageType.FATAL_ERROR, error.code, 0, error.text.encode())
        self.close()

    def close(self) -> None:
        """Close the connection once what was put has left."""
        self._writer.close()
