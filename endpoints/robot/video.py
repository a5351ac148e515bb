"""Video to robots: encoders that all receivers of a topic share, and a lane for each receiver.

An encoder has state: each packet needs those before it. So a receiver that misses one gets nothing more until the next
key frame, which it requests. It misses what its line does not carry. Therefore each receiver has a rate of bytes, which
falls after a drop and rises while there are none, in steps; receivers on the same step share an encoder.
"""

from __future__ import annotations

import asyncio
import uuid
from time import monotonic
from weakref import WeakValueDictionary

import msgspec

from converters import Recipe, Wire
from endpoints.data.frames import Message
from endpoints.data.hops import HopRecorder
from endpoints.robot.conversion import Outgoing, SharedConversion
from endpoints.robot.formats import Codecs
from endpoints.robot.interfaces import Publisher
from endpoints.robot.session import RobotSession
from endpoints.robot.workers import Workers
from rce.codecs.packed import PackedImage
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import RceError
from rce.net.budget import OVERHEAD
from rce.video.rate import RateConfig, RateControl

WAITING = 2  # packets that wait for the line before images are left out
KEY_PAUSE = 0.3  # seconds between key frames that receivers request
STEPS = RateConfig(lowest=23_328, highest=500_000, less=0.6, more=1 / 0.6)  # each rate is a power of 0.6 of the highest

_head = msgspec.json.Decoder(PackedImage)


class SharedEncoder:
    """Encoder of one camera at one rate, for all receivers.

    Args:
        workers: The workers.
        user: User of the receivers.
        recipe: Recipe of the packets; it gets a stream of its own.
    """

    def __init__(self, workers: Workers, user: str, recipe: Recipe) -> None:
        self._workers = workers
        self._user = user
        self._recipe = msgspec.structs.replace(recipe, stream=uuid.uuid4().hex)
        self._newest = -1.0  # when the newest image that was encoded came into this process
        self._key_wanted = True
        self._key_after = 0.0

    def request_key(self) -> None:
        """Make the next packet a key frame: somebody has joined, or misses a packet."""
        self._key_wanted = True

    async def encode(self, message: Message) -> Wire | None:
        """Return the packet of an image, which is encoded once; None if a newer one was encoded before."""
        found = message.conversions.get(self)
        if found is None or found.abandoned:
            if message.entered_at < self._newest:
                return None
            self._newest = message.entered_at
            key = self._key_wanted and monotonic() >= self._key_after
            if key:
                self._key_wanted, self._key_after = False, monotonic() + KEY_PAUSE
            work = self._workers.decode(self._user, self._recipe, message.payload, key=key)
            found = message.conversions[self] = SharedConversion(work)
        wire: Wire = await found.result()
        return wire


class SharedEncoders:
    """The encoders of an endpoint; one that no receiver uses any more is forgotten."""

    def __init__(self) -> None:
        self._encoders: WeakValueDictionary[tuple[bytes, Recipe, float], SharedEncoder] = WeakValueDictionary()

    def encoder(self, series: bytes, rate: float, workers: Workers, user: str, recipe: Recipe) -> SharedEncoder:
        """Return the encoder of a camera.

        Args:
            series: Id of the messages of the camera.
            rate: Images per second that receivers want, 0 for all.
            workers: The workers.
            user: User of the receivers.
            recipe: Recipe of the packets, with their rate of bytes.
        """
        key = series, recipe, rate
        found = self._encoders.get(key)
        if found is None:
            found = self._encoders[key] = SharedEncoder(workers, user, recipe)
        return found


class VideoPublisher(Publisher):
    """Sends the images of a topic to the robot as packets of video.

    The newest image waits while another one is encoded or the line is full.
    """

    def __init__(
        self,
        spec: InterfaceSpec,
        hops: HopRecorder,
        session: RobotSession,
        workers: Workers,
        codec: Codecs,
        encoders: SharedEncoders,
    ) -> None:
        super().__init__(spec, hops, session, workers, codec)
        self._workers, self._user = workers, session.name.partition("/")[0]
        self._encoders = encoders
        self._encoder: SharedEncoder | None = None
        self._control = RateControl(STEPS)
        self._next: Message | None = None
        self._task: asyncio.Task[None] | None = None
        self._expected = -1  # number of the next packet; -1 if it must be a key frame

    def close(self) -> None:
        """Drop the waiting messages and remove the interface from its session."""
        self._next = None
        if self._task is not None:
            self._task.cancel()
        super().close()

    def backlog(self) -> int:
        """Return the number of messages that wait for the robot."""
        return super().backlog() + (self._next is not None)

    def _queue(self, message: Message) -> None:
        if self._next is not None:
            self.dropped += 1
            self.report_drops()
            if self._line_full:
                self._adapt(dropped=True)
        self._next = message
        self._proceed()

    @property
    def _line_full(self) -> bool:
        return self.session.outbox.backlog(self.id) >= WAITING

    def _proceed(self) -> None:
        """Encode the image that waits, if nothing is in its way."""
        if self._next is None or self._task is not None or self._line_full:
            return
        message, self._next = self._next, None
        self._task = asyncio.create_task(self._send(message))

    async def _send(self, message: Message) -> None:
        try:
            wire = await self._encoder_of(message).encode(message)
        except RceError as error:
            self._expected = -1
            self._task = None
            self.session.error(error.with_item(self.spec.tag))
        else:
            self._task = None
            if wire is None or not self._fits(wire):
                self.dropped += 1
                self.report_drops()
            else:
                self._put_packet(message, wire)
        self._proceed()

    def _encoder_of(self, message: Message) -> SharedEncoder:
        recipe = msgspec.structs.replace(self._codec().recipe, bitrate=self._control.rate)
        rate = self.spec.delivery.rate
        found = self._encoders.encoder(message.series, rate, self._workers, self._user, recipe)
        if found is not self._encoder:
            self._encoder, self._expected = found, -1
            if found not in message.conversions:  # else it may be a key frame, or is the first that this robot misses
                found.request_key()
        return found

    def _fits(self, wire: Wire) -> bool:
        """Return whether the robot can decode a packet; request a key frame if it cannot."""
        head = _head.decode(wire.raw)
        if not head.key and head.number != self._expected:
            self._missed()
            return False
        self._expected = head.number + 1
        return True

    def _missed(self) -> None:
        """Send nothing before the next key frame."""
        self._expected = -1
        if self._encoder is not None:
            self._encoder.request_key()

    def _put_packet(self, message: Message, wire: Wire) -> None:
        until = monotonic() + self._max_age
        outgoing = Outgoing(self._codec(), self._head + b'"nil"', message, WAITING + 1, until)
        frame, blobs = outgoing.frame(wire)
        size = len(frame) + sum(map(len, blobs.values())) + OVERHEAD
        pieces = self._begun(outgoing, self._frames(message, frame, blobs))
        if dropped := self._put_in_outbox(outgoing, pieces, size):
            self.evicted(dropped)
        self._adapt(dropped=False)

    def _too_old(self, outgoing: Outgoing) -> bool:
        old = super()._too_old(outgoing)
        if not old:
            asyncio.get_running_loop().call_soon(self._proceed)  # the line has taken a packet
        return old

    def evicted(self, count: int) -> None:
        """Count and report packets that were dropped; what follows them cannot be decoded."""
        self._missed()
        self._adapt(dropped=True)
        super().evicted(count)

    def _adapt(self, *, dropped: bool) -> None:
        """Change the rate of bytes to what the line carries; another rate has another encoder."""
        self._control.report(monotonic(), dropped)
