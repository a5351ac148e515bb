"""Time, and control of a playback (`rce bag play`) that feeds the environment of a client."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable, Sequence

import msgspec
from msgspec import Raw, Struct

from endpoints.gateways.foxglove import messages
from endpoints.gateways.foxglove.messages import PlaybackCommand
from endpoints.gateways.guest import Guest
from endpoints.gateways.uses import PUBLISH, SUBSCRIBE, Arrived, Frame, Use
from rce.bag.playback import CONTROL, STATE, TYPE, PlaybackRequest, PlaybackState, encode
from rce.control.calls.watching import RosGraph
from rce.errors import MALFORMED, InvalidRequest, RceError

CLOCK, CLOCK_TYPE = "/clock", "rosgraph_msgs/msg/Clock"
_STAMP = {0: struct.Struct(">iI"), 1: struct.Struct("<iI")}  # by the second byte of CDR

Report = Callable[[RceError], None]
Greet = Callable[[PlaybackState | None], Frame]


class _Text(Struct):
    data: str


class Playback:
    """Playback and time of one client's environment.

    Args:
        guest: The client's guest.
        greet: Returns the message that tells the client whether there is a playback.
        report: Takes errors.
    """

    def __init__(self, guest: Guest, greet: Greet, report: Report) -> None:
        self._guest = guest
        self._greet = greet
        self._report = report
        self._uses: dict[str, Use] = {}  # by topic
        self._state: PlaybackState | None = None
        self._control: Use | None = None

    def update(self, graph: RosGraph) -> None:
        """Follow the clock and the playback that a graph has, and no others."""
        present = {each.name for each in graph.topics if each.publishers}
        self._follow(CLOCK, CLOCK_TYPE, CLOCK in present, self._clock, form="Forwarder", format="cdr")
        self._follow(STATE, TYPE, STATE in present, self._told)
        if STATE not in present and self._state is not None:
            self._state = None
            self._guest.send(self._greet(None))

    def _follow(
        self, topic: str, type: str, present: bool, receive: Callable[[Arrived], Sequence[Frame]], **form: str
    ) -> None:
        use = self._uses.get(topic)
        if use is not None and (not present or use.ended.done()):
            self._guest.drop(self._uses.pop(topic))
        elif use is None and present:
            self._uses[topic] = self._guest.use(SUBSCRIBE, topic, type, receive, self._failed, **form)  # type: ignore[arg-type]

    def _failed(self, _: str, error: RceError) -> None:
        self._report(error)

    def _clock(self, arrived: Arrived) -> Sequence[Frame]:
        cdr = memoryview(arrived.blob or b"")
        if self._state is not None or len(cdr) < 12 or cdr[1] not in _STAMP:  # a playback tells its time itself
            return ()
        seconds, nanoseconds = _STAMP[cdr[1]].unpack_from(cdr, 4)
        return (messages.time(seconds * 1_000_000_000 + nanoseconds),)

    def _told(self, arrived: Arrived) -> Sequence[Frame]:
        try:
            text = msgspec.json.decode(bytes(arrived.value[:-1]), type=_Text).data
            state = msgspec.json.decode(text, type=PlaybackState)
        except MALFORMED:
            return ()  # anybody may publish there
        before, self._state = self._state, state
        frames: list[Frame] = [messages.time(state.time)]
        if before is None or (before.start, before.end) != (state.start, state.end):
            frames.insert(0, self._greet(state))
            before = None
        if before is None or state.request or (before.status, before.speed) != (state.status, state.speed):
            frames.append(messages.playback_state(state))
        return frames

    def control(self, command: PlaybackCommand) -> None:
        """Pass a command of the client on.

        Raises:
            InvalidRequest: There is no playback.
        """
        if self._state is None:
            raise InvalidRequest("there is no playback in this environment: start one with `rce bag play`")
        request = PlaybackRequest(command.play, command.speed, command.seek, command.request)
        self._guest.run(self._send(request))

    async def _send(self, request: PlaybackRequest) -> None:
        try:
            use = self._control or self._begin_control()
            await asyncio.shield(use.ready)
        except RceError as error:
            self._report(error)
            return
        value = Raw(msgspec.json.encode(_Text(encode(request))))
        self._guest.data(use, "", value, self._report)

    def _begin_control(self) -> Use:
        def ended(_: RceError) -> None:
            self._control = None

        self._control = use = self._guest.use(PUBLISH, CONTROL, TYPE, lambda _: (), self._failed)
        use.on_end(ended)
        return use
