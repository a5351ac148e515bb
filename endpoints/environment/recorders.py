"""Recorders of an environment: each writes topics into recordings at the store of its machine."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable
from contextlib import suppress
from functools import partial
from pathlib import Path
from uuid import uuid4

from twisted.logger import Logger

from endpoints.data.frames import Message
from endpoints.data.sink import Sink
from endpoints.environment.interfaces import RosContext, RosInterface
from endpoints.environment.topics import SubscriberInterface
from rce.bag.transfer import Broken, StoredFile
from rce.bag.writer import BagWriter, Limits, Topic, join_definitions
from rce.control.calls.endpoints import MAX_TEXT, InterfaceSpec, RecorderEnded, RecorderSpec
from rce.errors import ErrorInfo, RceError, StartFailed
from rce.net.outbox import Owner
from rce.protocol.messages import Qos
from rce.protocol.names import parse_type

DISCOVERY = 1.0  # seconds between looks for new topics
RETRY = 1.0  # seconds after which a store that was lost is tried again
QOS = Qos(depth=1000)
PEER = bytes(16)  # id of the recorder as the peer of its interfaces

log = Logger()
ReadTopics = Callable[[], Awaitable[dict[str, str]]]
"""Returns the types of the topics of the environment by their names."""


class Recorders:
    """Starts and stops recorders; `ended` is called for each one that ends by itself."""

    def __init__(
        self,
        context: RosContext,
        store: Path | None,
        topics: ReadTopics,
        ended: Callable[[RecorderEnded], None],
    ) -> None:
        """Begin without recorders.

        Args:
            context: What interfaces of the environment use.
            store: Socket of the store of recordings; None if the machine has none.
            topics: Reads the topics of the environment.
            ended: Takes the report of a recorder that ended by itself.
        """
        self._context = context
        self._store = store
        self._topics = topics
        self._ended = ended
        self._running: dict[str, _Recorder] = {}
        self._locks: dict[str, asyncio.Lock] = {}

    @property
    def specs(self) -> dict[str, RecorderSpec]:
        """Recorders by tag."""
        return {tag: recorder.spec for tag, recorder in self._running.items()}

    async def start(self, spec: RecorderSpec, patient: bool = False) -> None:
        """Start a recorder unless it runs already; one with the same tag and another spec is replaced.

        A `patient` one waits for a store that cannot be reached at present.

        Raises:
            StartFailed: The machine of this environment keeps no recordings.
            Broken: The store cannot be reached at present.
            RceError: The store refuses the recording, because a quota is used up, for example.
        """
        async with self._locks.setdefault(spec.tag, asyncio.Lock()):
            present = self._running.get(spec.tag)
            if present is not None:
                if present.spec == spec:
                    return
                await present.stop()
            if self._store is None:
                raise StartFailed("the machine of this environment keeps no recordings: use `rce bag record`")
            recorder = _Recorder(spec, self._context, self._store, self._topics, self._end)
            self._running[spec.tag] = recorder
            try:
                await recorder.start(patient)
            except BaseException:
                self._running.pop(spec.tag, None)
                raise

    async def stop(self, tag: str) -> None:
        """Stop a recorder, if it runs, and complete its file."""
        async with self._locks.setdefault(tag, asyncio.Lock()):
            recorder = self._running.pop(tag, None)
            if recorder is not None:
                await recorder.stop()

    async def sync(self, specs: Iterable[RecorderSpec]) -> dict[str, ErrorInfo]:
        """Stop and start recorders so that exactly these run; return the errors of those that did not start."""
        wanted = {spec.tag: spec for spec in specs}
        failed: dict[str, ErrorInfo] = {}
        for tag in set(self._running) - set(wanted):
            await self.stop(tag)
        for spec in wanted.values():
            try:
                await self.start(spec, patient=True)
            except RceError as error:
                failed[f"recorder:{spec.tag}"] = error.info
        return failed

    async def stop_all(self) -> None:
        """Stop all recorders."""
        await asyncio.gather(*(self.stop(tag) for tag in list(self._running)))

    def _end(self, recorder: _Recorder, error: RceError) -> None:
        tag = recorder.spec.tag
        log.warn("recorder {tag} ended: {error}", tag=tag, error=str(error))
        if self._running.get(tag) is recorder:
            del self._running[tag]
        self._ended(RecorderEnded(tag, str(error)[:MAX_TEXT]))


class _Recorder:
    """One recorder, with an interface for each topic and one recording at a time."""

    def __init__(
        self,
        spec: RecorderSpec,
        context: RosContext,
        store: Path,
        topics: ReadTopics,
        ended: Callable[[_Recorder, RceError], None],
    ) -> None:
        self.spec = spec
        self.writer: BagWriter | None = None
        self.lost: Counter[str] = Counter()  # messages that no recording has, by topic
        self._context = context
        self._store = store
        self._topics = topics
        self._ended = ended
        self._interfaces: dict[str, RosInterface | None] = {}  # by topic; None if its type is not known
        self._stopping = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    async def start(self, patient: bool) -> None:
        """Begin to record; see `Recorders.start`."""
        try:
            self.writer = await self._open()
        except Broken:
            if not patient:
                raise
        self._task = asyncio.create_task(self._run())

    async def stop(self) -> None:
        """Complete the file and end."""
        self._stopping.set()
        if self._task is not None:
            await self._task

    async def _open(self) -> BagWriter:
        limits = Limits(self.spec.max_size, self.spec.max_duration)
        create = partial(StoredFile, self._store, self.spec.tag)
        return await asyncio.to_thread(BagWriter, Path("recording"), limits, lambda _: create())

    async def _run(self) -> None:
        error: RceError | None = None
        try:
            while not self._stopping.is_set() and error is None:
                await self._discover()
                error = await self._renew()
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._stopping.wait(), DISCOVERY if self.writer else RETRY)
        finally:
            for interface in filter(None, self._interfaces.values()):
                interface.peers.clear()
                interface.stopped()
                interface.close()
            await self._close()
        if error is not None:
            self._ended(self, error)

    async def _renew(self) -> RceError | None:
        """Begin another recording if the store was lost; return the error that ends the recorder, if there is one."""
        if self.writer is not None and self.writer.error is not None:
            error, self.lost = self.writer.error, self.lost + self.writer.dropped
            self.writer = None
            if not isinstance(error, Broken):
                return error
            log.warn("recorder {tag}: {error}; another file begins", tag=self.spec.tag, error=str(error))
        if self.writer is None:
            try:
                self.writer = await self._open()
            except Broken:
                return None
            except RceError as error:
                return error
        return None

    async def _close(self) -> None:
        writer, self.writer = self.writer, None
        if writer is None:
            return
        for topic, interface in self._interfaces.items():
            if interface is not None and interface.dropped:
                self.lost[topic] += interface.dropped
        try:
            await asyncio.to_thread(writer.close, self.lost)
        except RceError as error:
            log.warn("recorder {tag}: {error}", tag=self.spec.tag, error=str(error))

    async def _discover(self) -> None:
        """Subscribe to topics that are new."""
        found = await self._topics()
        wanted = self.spec.topics or [name for name in found if "/_" not in name]  # without hidden ones
        for name in wanted:
            if name in found and name not in self._interfaces:
                try:
                    self._interfaces[name] = await self._subscribe(name, found[name])
                except RceError as error:
                    self._interfaces[name] = None
                    log.warn("recorder {tag} leaves {topic} out: {error}", tag=self.spec.tag, topic=name, error=error)

    async def _subscribe(self, name: str, type_name: str) -> RosInterface:
        kind = parse_type(type_name)
        texts = self._context.definitions.describe(type_name, "msg")
        spec = InterfaceSpec(uuid4().hex, "", name, "SubscriberInterface", type_name, name, QOS)
        interface = SubscriberInterface(spec, self._context)
        await interface.open()
        interface.peers[PEER] = _TopicSink(self, Topic(name, kind.msg, join_definitions(texts, kind.msg)))
        interface.started()
        interface.joined(PEER)
        return interface


class _TopicSink(Sink):
    """Writes the messages of one topic."""

    def __init__(self, recorder: _Recorder, topic: Topic) -> None:
        super().__init__()
        self._recorder = recorder
        self._topic = topic

    def send(self, message: Message, keep: int | None, owner: Owner | None = None) -> int:
        """Write a message with the present time."""
        if self._recorder.writer is None:
            self._recorder.lost[self._topic.name] += 1
        else:
            self._recorder.writer.put(self._topic, bytes(message.payload), time.time_ns())
        return 0
