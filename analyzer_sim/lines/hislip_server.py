"""HiSLIP on TCP (IVI-6.1, 1.0 and 1.1, synchronized mode): pairs of connections, and the sessions that work on them."""

import asyncio
from collections import deque
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Iterator
from contextlib import aclosing, suppress

from analyzer_sim.lines.dispatcher import Dispatcher
from analyzer_sim.lines.hislip_session import (
    MAX_PAYLOAD_BYTES,
    Decoder,
    ErrorCode,
    FatalCode,
    FatalProtocolError,
    HislipSession,
    LockAnswer,
    Message,
    MessageType,
    Phase,
    RefusedMessageError,
    Request,
    answer_parts,
    decode_size,
    encode,
    encode_size,
)
from analyzer_sim.lines.line_faults import FaultyLine, LineEndedError, LineFaults

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


#: requests that wait for execution before the channel is not read any more
_QUEUED_REQUESTS = 64
#: the two channels race: how long a status query lets requests pass that were sent before it, s
_HEAD_START_S = 0.001
#: how long the release of a lock waits for the last request sent under it, s
_ARRIVAL_PATIENCE_S = 0.2
_VENDOR = int.from_bytes(b"SO", "big")
_LARGEST_REMOTE_CONTROL = 6


class Conversation:
    """One session from Initialize to the end of either channel.

    Parameters
    ----------
    state : HislipSession
        What is legal when.
    dispatcher : Dispatcher
        The instrument and those who share it.
    synchronous : Channel
        The first channel; :meth:`attach` brings the second.
    """

    def __init__(self, state: HislipSession, dispatcher: Dispatcher, synchronous: Channel) -> None:
        self.state = state
        self._dispatcher = dispatcher
        self._session = dispatcher.new_session("hislip")
        self._synchronous = synchronous
        self._asynchronous: Channel | None = None
        self._requests: deque[Request] = deque()
        self._moved = asyncio.Event()
        self._worker: asyncio.Task[None] | None = None
        self._is_executing = False
        self._lock_task: asyncio.Task[None] | None = None
        self._handlers: dict[int, Callable[[Channel, Message], Awaitable[None]]] = {
            MessageType.ASYNC_MAX_MSG_SIZE: self._exchange_size,
            MessageType.ASYNC_LOCK: self._lock,
            MessageType.ASYNC_LOCK_INFO: self._report_locks,
            MessageType.ASYNC_STATUS_QUERY: self._report_status,
            MessageType.ASYNC_REMOTE_LOCAL_CONTROL: self._control_remote,
            MessageType.ASYNC_DEVICE_CLEAR: self._clear,
        }

    def attach(self, channel: Channel, message: Message) -> None:
        """Take the asynchronous channel, whose first message this is."""
        self.state.step(message, is_synchronous=False)
        self._asynchronous = channel
        channel.put(MessageType.ASYNC_INITIALIZE_RESPONSE, 0, _VENDOR)
        self._dispatcher.watchers.add(self._check_service_request)
        self._start_worker()

    def close(self) -> None:
        """End the session: both channels, its locks, what it was doing."""
        self.state.phase = Phase.CLOSED
        self._requests.clear()
        self._wake()
        self._dispatcher.watchers.discard(self._check_service_request)
        for task in (self._worker, self._lock_task):
            if task is not None:
                task.cancel()
        for channel in (self._synchronous, self._asynchronous):
            if channel is not None:
                channel.close()
        self._dispatcher.leave(self._session)

    def expire(self) -> None:
        """End a session whose asynchronous channel has not come."""
        if self.state.phase is Phase.HALF_OPEN:
            self._synchronous.end(
                FatalProtocolError(FatalCode.CHANNELS_INCOMPLETE, "the asynchronous channel did not come")
            )

    # the synchronous channel

    async def on_synchronous(self, message: Message) -> None:
        """Act on a message of the synchronous channel."""
        self.state.step(message, is_synchronous=True)
        if message.kind == MessageType.DEVICE_CLEAR_COMPLETE:
            self._synchronous.put(MessageType.DEVICE_CLEAR_ACKNOWLEDGE)
            self._start_worker()
        elif message.kind in {MessageType.DATA, MessageType.DATA_END, MessageType.TRIGGER}:
            while len(self._requests) >= _QUEUED_REQUESTS and self.state.phase is not Phase.CLOSED:
                await self._move()
            request = self.state.gather(message)
            if request is not None:
                self._requests.append(request)
                self._wake()

    def _start_worker(self) -> None:
        if self._worker is None or self._worker.done():
            self._worker = asyncio.create_task(self._work())
            self._worker.add_done_callback(self._end_with_worker)

    def _end_with_worker(self, worker: asyncio.Task[None]) -> None:
        """End the session when its worker has ended by itself: nobody would answer any more."""
        if worker.cancelled():
            return
        self.close()
        error = worker.exception()
        if error is not None and not isinstance(error, (ConnectionError, LineEndedError)):
            context = {"message": "a HiSLIP session has failed", "exception": error}
            worker.get_loop().call_exception_handler(context)

    async def _work(self) -> None:
        """Execute requests strictly in the order of their arrival."""
        while True:
            while not self._requests:
                await self._move()
            request = self._requests.popleft()
            self._wake()
            if self.state.is_interrupted_by(request):
                self._interrupt(request.message_id)
            self._is_executing = True
            await self._answer(request)
            self._is_executing = False
            self._wake()

    async def _answer(self, request: Request) -> None:
        """Execute one request and send its answer; a second answer in one request interrupts the first."""
        answer, readings = b"", self._session.readings
        for program in request.programs:
            response = await self._dispatcher.execute(self._session, program)
            if response is None:
                continue
            if answer:
                self._session.push_error(-410, "an answer was not read")
            answer, readings = response, self._session.readings
        if not answer:
            return
        if self._requests:
            self._interrupt(self._requests[0].message_id)
            return
        self.state.is_unread = True
        self._check_service_request()
        parts = answer_parts(answer, request.message_id, self.state.client_bytes)
        is_sent = await self._synchronous.line.send(answer, self._until_interrupted(parts))
        if is_sent and next(parts, None) is None:
            self._session.report_delivery(readings)

    def _until_interrupted(self, parts: Iterator[bytes]) -> Iterator[bytes]:
        """Give parts of an answer as long as no further request waits."""
        for part in parts:
            yield part
            if self._requests:
                return

    def _interrupt(self, message_id: int) -> None:
        """Tell that a request came while an answer was unread."""
        self._session.push_error(-410, "a message came while an answer was unread")
        self._synchronous.put(MessageType.INTERRUPTED, 0, message_id)
        if self._asynchronous is not None:
            self._asynchronous.put(MessageType.ASYNC_INTERRUPTED, 0, message_id)

    async def _move(self) -> None:
        await self._moved.wait()

    def _wake(self) -> None:
        self._moved.set()
        self._moved = asyncio.Event()

    # the asynchronous channel

    async def on_asynchronous(self, channel: Channel, message: Message) -> None:
        """Act on a message of the asynchronous channel."""
        self.state.step(message, is_synchronous=False)
        handler = self._handlers.get(message.kind)
        if handler is not None:
            await handler(channel, message)
        await channel.drain()

    async def _exchange_size(self, channel: Channel, message: Message) -> None:
        size_bytes = decode_size(message.payload)
        if size_bytes is None:
            raise RefusedMessageError(ErrorCode.UNIDENTIFIED, "a size has eight bytes")
        self.state.client_bytes = size_bytes
        channel.put(MessageType.ASYNC_MAX_MSG_SIZE_RESPONSE, 0, 0, encode_size(MAX_PAYLOAD_BYTES))

    async def _report_locks(self, channel: Channel, _message: Message) -> None:
        locks = self._dispatcher.locks
        channel.put(MessageType.ASYNC_LOCK_INFO_RESPONSE, int(locks.is_exclusive), locks.holders)

    async def _control_remote(self, channel: Channel, message: Message) -> None:
        if message.control > _LARGEST_REMOTE_CONTROL:
            raise RefusedMessageError(ErrorCode.UNKNOWN_CONTROL_CODE, "remote/local control is 0 to 6")
        channel.put(MessageType.ASYNC_REMOTE_LOCAL_RESPONSE)

    async def _report_status(self, channel: Channel, message: Message) -> None:
        self.state.on_delivery(message)
        await asyncio.sleep(_HEAD_START_S)
        byte = self._session.status_byte(has_response=self.state.is_unread)
        channel.put(MessageType.ASYNC_STATUS_RESPONSE, self.state.polled(byte))

    def _check_service_request(self) -> None:
        """Request service when a reason that ``*SRE`` enables has come up."""
        byte = self._session.status_byte(has_response=self.state.is_unread)
        enable = self._dispatcher.instrument.status.service_enable
        if self.state.is_service_wanted(byte, enable) and self._asynchronous is not None:
            self._asynchronous.put(MessageType.ASYNC_SERVICE_REQUEST, byte)

    async def _clear(self, channel: Channel, _message: Message) -> None:
        """Clear the session: what it executes ends; settings, sweep and the other sessions stay as they are."""
        self._requests.clear()
        self._wake()
        if self._worker is not None:
            self._worker.cancel()
            await asyncio.gather(self._worker, return_exceptions=True)
        self._is_executing = False
        self._session.clear()
        channel.put(MessageType.ASYNC_DEVICE_CLEAR_ACKNOWLEDGE)

    async def _lock(self, channel: Channel, message: Message) -> None:
        """Ask for a lock or give one back, without holding up the channel."""
        if message.control > 1:
            raise RefusedMessageError(ErrorCode.UNKNOWN_CONTROL_CODE, "a lock is requested or released")
        if self._lock_task is not None and not self._lock_task.done():
            channel.put(MessageType.ASYNC_LOCK_RESPONSE, LockAnswer.INVALID)
            return
        self._lock_task = asyncio.create_task(self._answer_lock(channel, message))

    async def _answer_lock(self, channel: Channel, message: Message) -> None:
        if message.control:
            answer = await self._acquire(message.payload.decode("latin-1"), message.parameter / 1e3)
        else:
            answer = await self._release(message.parameter)
        channel.put(MessageType.ASYNC_LOCK_RESPONSE, answer)

    async def _acquire(self, key: str, timeout_s: float) -> LockAnswer:
        locks, deadline_s = self._dispatcher.locks, asyncio.get_running_loop().time() + timeout_s
        while (answer := locks.request(self._session, key)) is None:
            try:
                async with asyncio.timeout_at(deadline_s):
                    await self._dispatcher.change()
            except TimeoutError:
                return LockAnswer.FAILURE
        self._dispatcher.announce()
        return answer

    async def _release(self, message_id: int) -> LockAnswer:
        """Give a lock back once the last request sent under it was executed."""
        with suppress(TimeoutError):  # a request that does not come does not keep the lock
            async with asyncio.timeout(_ARRIVAL_PATIENCE_S):
                while not self.state.has_taken(message_id):
                    await self._move()
        while self._requests or self._is_executing:
            await self._move()
        answer = self._dispatcher.locks.release(self._session)
        self._dispatcher.announce()
        return answer


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
