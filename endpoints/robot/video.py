"""Video to robots: encoders that the receivers of a topic share.

An encoder has state: each packet needs those before it. So it takes the newest image when it is idle, and passes the
packet to all its receivers. One that misses a packet gets nothing more until the next key frame, which it requests. It
misses what its line does not carry. Therefore each receiver has a rate of bytes, which falls when its line stays full
and rises while it does not, in steps; receivers on the same step share an encoder.
"""

from __future__ import annotations

import asyncio
import uuid
from dataclasses import replace
from time import monotonic
from weakref import WeakValueDictionary

import msgspec

from converters import Recipe, Wire
from endpoints.data.frames import Message
from endpoints.data.hops import HopRecorder
from endpoints.robot.conversion import Outgoing
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
MAX_STRAIN = 10.0  # images left out because the line was full, until the rate falls: a short stall is no slow line
RELIEF = 0.25  # of the strain, by each packet that the line takes
KEY_PAUSE = 0.3  # seconds between key frames that receivers request
STEPS = RateConfig(lowest=32_000, highest=500_000, less=0.4, more=2.5)  # four rates, so that few encoders serve many

_head = msgspec.json.Decoder(PackedImage)


class SharedEncoder:
    """Encoder of one camera at one rate, for all receivers.

    Attributes:
        receivers: Those who get its packets.
    """

    def __init__(self, workers: Workers, user: str, recipe: Recipe) -> None:
        """Make an encoder; the recipe gets a stream of its own."""
        self.receivers: set[VideoPublisher] = set()
        self._workers = workers
        self._user = user
        self._recipe = msgspec.structs.replace(recipe, stream=uuid.uuid4().hex)
        self._next: Message | None = None
        self._newest = -1.0  # when the newest image came into this process
        self._task: asyncio.Task[None] | None = None
        self._key_wanted = True
        self._key_after = 0.0

    def leave(self, receiver: VideoPublisher) -> None:
        """Remove a receiver; without any, the image that waits is left out."""
        self.receivers.discard(receiver)
        if not self.receivers and self._next is not None:
            self._next = None
            receiver.missed()

    def request_key(self) -> None:
        """Make the next packet a key frame: somebody has joined, or misses a packet."""
        self._key_wanted = True

    def offer(self, message: Message) -> None:
        """Encode an image as soon as possible; all receivers offer the same ones, of which the newest waits."""
        if message.entered_at <= self._newest:
            return
        self._newest = message.entered_at
        if self._next is not None:
            for receiver in self.receivers:
                receiver.missed()
        self._next = message
        self.proceed()

    def proceed(self) -> None:
        """Encode the image that waits, if nothing else is being encoded and a receiver has room for the packet."""
        if self._next is not None and self._task is None and any(each.has_room for each in self.receivers):
            message, self._next = self._next, None
            self._task = asyncio.create_task(self._encode(message))

    async def _encode(self, message: Message) -> None:
        key = self._key_wanted and monotonic() >= self._key_after
        if key:
            self._key_wanted, self._key_after = False, monotonic() + KEY_PAUSE
        try:
            wire = await self._workers.decode(self._user, self._recipe, message.payload, key=key)
        except RceError as error:
            for receiver in tuple(self.receivers):
                receiver.failed(error)
        else:
            head = _head.decode(wire.raw)
            for receiver in tuple(self.receivers):
                receiver.packet(message, head, wire)
        self._task = None
        self.proceed()


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
    """Sends the images of a topic to the robot as packets of video."""

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
        self._source = b""  # of the images, as this interface gets them
        self._control = RateControl(STEPS)
        self._expected = -1  # number of the next packet; -1 if it must be a key frame
        self._strain = 0.0

    def close(self) -> None:
        """Drop the waiting messages and remove the interface from its session."""
        self._leave()
        super().close()

    def stopped(self) -> None:
        """Tell the robot that the interface has no peer any more."""
        self._leave()
        super().stopped()

    def _leave(self) -> None:
        if self._encoder is not None:
            self._encoder.leave(self)
            self._encoder = None

    def _queue(self, message: Message) -> None:
        self._source = message.source
        self._join(message.series).offer(message)

    def _join(self, series: bytes) -> SharedEncoder:
        """Return the encoder of a camera at the present rate."""
        recipe = msgspec.structs.replace(self._codec().recipe, bitrate=self._control.rate)
        found = self._encoders.encoder(series, self.spec.delivery.rate, self._workers, self._user, recipe)
        if found is not self._encoder:
            self._leave()
            self._encoder, self._expected = found, -1
            found.receivers.add(self)
            found.request_key()
        return found

    # --- for the encoder ----------------------------------------------------------------------------------------------

    @property
    def has_room(self) -> bool:
        """True unless the line is full."""
        return self.session.outbox.backlog(self.id) < WAITING

    def packet(self, message: Message, head: PackedImage, wire: Wire) -> None:
        """Send a packet, unless the line is full or the robot cannot decode it."""
        if not self.has_room:
            self._expected = -1
            self.missed()
        elif not head.key and head.number != self._expected:
            self._need_key()
            self.missed()
        else:
            self._expected = head.number + 1
            self._put_packet(replace(message, source=self._source), wire)

    def missed(self) -> None:
        """Count an image that was left out; the rate falls if that is often because the line is full."""
        self.dropped += 1
        self.report_drops()
        if not self.has_room:
            self._strain += 1
            if self._strain > MAX_STRAIN:
                self._adapt(dropped=True)

    def failed(self, error: RceError) -> None:
        """Report an image that cannot be encoded."""
        self._expected = -1
        self.session.error(error.with_item(self.spec.tag))

    # --- the line -----------------------------------------------------------------------------------------------------

    def _need_key(self) -> None:
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
        self._strain = max(0.0, self._strain - RELIEF)
        self._adapt(dropped=False)

    def _too_old(self, outgoing: Outgoing) -> bool:
        old = super()._too_old(outgoing)
        if not old and self._encoder is not None:
            asyncio.get_running_loop().call_soon(self._encoder.proceed)  # the line has taken a packet
        return old

    def evicted(self, count: int) -> None:
        """Count and report packets that were dropped; what follows them cannot be decoded."""
        self._need_key()
        self._adapt(dropped=True)
        super().evicted(count)

    def _adapt(self, *, dropped: bool) -> None:
        """Change the rate of bytes to what the line carries; another rate has another encoder."""
        if dropped:
            self._strain = 0.0
        self._control.report(monotonic(), dropped)
