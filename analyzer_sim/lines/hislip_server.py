"""HiSLIP on TCP (IVI-6.1, 1.0 and 1.1, synchronized mode, sub-address ``hislip0``): pairs connections into sessions.

Overlap mode is declined, and nothing of 2.0 (TLS, SASL) is known. The instrument is not announced by mDNS: a client is
given the address.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import aclosing

from analyzer_sim.lines.dispatcher import Dispatcher
from analyzer_sim.lines.hislip_channel import Channel
from analyzer_sim.lines.hislip_conversation import Conversation
from analyzer_sim.lines.hislip_messages import FatalCode, FatalProtocolError, Message, MessageType
from analyzer_sim.lines.hislip_session import HislipSession, Phase, RefusedMessageError
from analyzer_sim.lines.line_faults import LineFaults

#: sessions at once
MAX_SESSIONS = 64
#: longest wait for the first message of a connection and for the second connection of a session, s
INITIALIZE_PATIENCE_S = 10.0
#: sub-addresses served; an empty one means the first
_SUB_ADDRESSES = frozenset({b"", b"hislip0"})
_SESSION_NUMBERS = 1 << 16


class HislipServer:
    """All HiSLIP sessions of one instrument.

    Parameters
    ----------
    dispatcher : Dispatcher
        The instrument and those who share it.
    faults : LineFaults
        Faults of the line, for tests of clients.
    """

    def __init__(self, dispatcher: Dispatcher, faults: LineFaults) -> None:
        self._dispatcher = dispatcher
        self._faults = faults
        self._conversations: dict[int, Conversation] = {}
        self._last_number = 0

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection, whichever channel it turns out to be, until either side ends it."""
        channel = Channel(reader, writer, self._faults)
        try:
            async with aclosing(channel.messages()) as messages:
                await self._serve_first(channel, messages)
        except FatalProtocolError as error:
            channel.end(error)
        except (ConnectionError, TimeoutError, StopAsyncIteration):
            pass  # the client left or never spoke
        finally:
            channel.close()

    async def _serve_first(self, channel: Channel, messages: AsyncIterator[Message]) -> None:
        """Let the first message decide which channel this is."""
        async with asyncio.timeout(INITIALIZE_PATIENCE_S):
            first = await anext(messages)
        if first.kind == MessageType.INITIALIZE:
            await self._serve_synchronous(channel, messages, first)
        elif first.kind == MessageType.ASYNC_INITIALIZE:
            await self._serve_asynchronous(channel, messages, first)
        else:
            raise FatalProtocolError(FatalCode.INVALID_INITIALIZATION, "a connection begins with an Initialize")

    async def _serve_synchronous(self, channel: Channel, messages: AsyncIterator[Message], first: Message) -> None:
        state = self._open(first)
        conversation = Conversation(state, self._dispatcher, channel)
        self._conversations[state.number] = conversation
        timer = asyncio.get_running_loop().call_later(INITIALIZE_PATIENCE_S, conversation.expire)
        try:
            channel.put(MessageType.INITIALIZE_RESPONSE, 0, state.version << 16 | state.number)
            async for message in messages:
                try:
                    await conversation.on_synchronous(message)
                except RefusedMessageError as refusal:
                    channel.refuse(refusal)
                if state.phase is Phase.CLOSED:
                    break
        except FatalProtocolError as error:
            channel.end(error)
        finally:
            timer.cancel()
            del self._conversations[state.number]
            conversation.close()

    def _open(self, first: Message) -> HislipSession:
        """Return the state of a new session.

        Raises
        ------
        FatalProtocolError
            There are too many, or the sub-address is not served.
        """
        if len(self._conversations) >= MAX_SESSIONS:
            raise FatalProtocolError(FatalCode.TOO_MANY_CLIENTS, f"{MAX_SESSIONS} sessions are open")
        if first.payload.lower() not in _SUB_ADDRESSES:
            raise FatalProtocolError(FatalCode.INVALID_INITIALIZATION, "the sub-address is hislip0")
        self._last_number = (self._last_number + 1) % _SESSION_NUMBERS
        while self._last_number in self._conversations:
            self._last_number = (self._last_number + 1) % _SESSION_NUMBERS
        return HislipSession(self._last_number, first.parameter >> 16)

    async def _serve_asynchronous(self, channel: Channel, messages: AsyncIterator[Message], first: Message) -> None:
        conversation = self._conversations.get(first.parameter)
        if conversation is None:
            raise FatalProtocolError(FatalCode.INVALID_INITIALIZATION, "no session of this number waits")
        conversation.attach(channel, first)
        try:
            async for message in messages:
                try:
                    await conversation.on_asynchronous(channel, message)
                except RefusedMessageError as refusal:
                    channel.refuse(refusal)
                if conversation.state.phase is Phase.CLOSED:
                    break
        except FatalProtocolError as error:
            channel.end(error)
        finally:
            conversation.close()
