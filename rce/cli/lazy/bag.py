"""Implementation of `bag record|play|info`; the first two work as a guest in an environment."""

from __future__ import annotations

import argparse
import asyncio
import signal
import struct
import time
from collections.abc import Coroutine
from contextlib import suppress

import msgspec

from rce.bag import playback
from rce.bag.player import Player
from rce.bag.reader import Recorded, Summary, summarize
from rce.bag.writer import MEGABYTE, BagWriter, Limits, Topic, join_definitions
from rce.cli import output
from rce.cli.lazy.guest import Guest
from rce.cli.session import ConsoleSession
from rce.client import Publisher
from rce.errors import MALFORMED, InvalidRequest, NotFound
from rce.protocol.messages import DropEvent, Qos
from rce.protocol.names import parse_type
from rce.spelling import did_you_mean

QOS = Qos(depth=10_000)
DEPTH = 10_000  # messages of a topic that may wait here
DISCOVERY = 2.0  # seconds between looks for new topics
CLOCK_PERIOD = 0.025  # seconds between messages of /clock
CLOCK = "/clock"
SETTLING = 1.0  # seconds: subscribers find new publishers, and the last message passes the interfaces


class Recorder:
    """Recording of topics of an environment."""

    def __init__(self, guest: Guest, writer: BagWriter, wanted: list[str]) -> None:
        """Record the `wanted` topics, or all that are not hidden if there are none."""
        self.lost: dict[str, int] = {}  # messages that the platform dropped, by topic
        self._guest = guest
        self._writer = writer
        self._wanted = wanted
        self._topics: dict[str, Topic] = {}  # by tag of the interface

    async def discover(self) -> None:
        """Subscribe to topics that are new.

        Raises:
            NotFound: A wanted topic does not exist.
        """
        known = {topic.name for topic in self._topics.values()}
        found = {each.name: each.types[0] for each in await self._guest.ros_names("topics")}
        for name in self._wanted:
            if name not in found:
                hint = did_you_mean(name, found) or "see `rce topic list`"
                raise NotFound(f"there is no topic {name} in {self._guest.environment} at present: {hint}")
        for name in self._wanted or [name for name in found if "/_" not in name]:
            if name not in known:
                await self._subscribe(name, found[name])

    async def _subscribe(self, name: str, type_name: str) -> None:
        kind = parse_type(type_name)
        texts = (await self._guest.describe(type_name)).texts
        tag = f"t{len(self._topics)}"
        topic = self._topics[tag] = Topic(name, kind.msg, join_definitions(texts, kind.msg))
        inside = await self._guest.add_interface(tag, "SubscriberInterface", type_name, name, QOS)
        subscriber = await self._guest.robot.subscriber(tag, type_name, to=inside, raw=True, depth=DEPTH, qos=QOS)
        subscriber.call(lambda cdr: self._writer.put(topic, cdr, time.time_ns()))
        print(f"recording {name} ({kind.msg})", flush=True)

    async def count_drops(self) -> None:
        """Note what the platform drops, until cancelled."""
        async for event in self._guest.robot.events():
            if isinstance(event, DropEvent) and (tag := _own_tag(event.iTag, self._guest)) in self._topics:
                self.lost[self._topics[tag].name] = event.count

    @property
    def topics(self) -> int:
        """Number of topics."""
        return len(self._topics)


def _own_tag(tag: str, guest: Guest) -> str:
    """Return the tag of the guest's own interface for a drop there or at the end inside the environment."""
    return tag.removeprefix(f"{guest.environment}/").removeprefix(f"{guest.robot.name}.")


async def record(guest: Guest, args: argparse.Namespace) -> int:
    """Record topics until Ctrl-C, or for some seconds."""
    ended = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGINT, ended.set)
    writer = BagWriter(args.out, Limits(int(args.max_size * MEGABYTE), args.max_duration))
    recorder = Recorder(guest, writer, ["/" + name.lstrip("/") for name in args.topics])
    drops = asyncio.create_task(recorder.count_drops())
    until = time.monotonic() + args.duration if args.duration else float("inf")
    try:
        await recorder.discover()
        print(f"{recorder.topics} topics into {args.out}; Ctrl-C ends the recording", flush=True)
        while not ended.is_set() and time.monotonic() < until and writer.error is None:
            with suppress(TimeoutError):
                await asyncio.wait_for(ended.wait(), min(DISCOVERY, until - time.monotonic()))
            if not args.topics and not ended.is_set():
                await recorder.discover()
    finally:
        drops.cancel()
        await asyncio.to_thread(writer.close, recorder.lost)
        _report(writer)
    return 0


def _report(writer: BagWriter) -> None:
    size = output.size_text(sum(path.stat().st_size for path in writer.paths))
    print(f"{writer.messages} messages, {size} in {', '.join(map(str, writer.paths))}")
    for topic, number in writer.dropped.items():
        print(f"{number} messages of {topic} were dropped")


async def play(guest: Guest, args: argparse.Namespace) -> int:
    """Publish the messages of a recording at the intervals of their arrival, as viewers at a gateway control it."""
    if not args.rate > 0:
        raise InvalidRequest("--rate: it is above 0, as 0.5 for half the speed")
    summary = await asyncio.to_thread(summarize, args.file)
    publishers = {
        topic: await _publisher(guest, f"p{number}", topic, type_name)
        for number, (topic, type_name) in enumerate(summary.types.items())
    }
    clock = await _publisher(guest, "clock", CLOCK, "rosgraph_msgs/msg/Clock") if args.clock else None

    async def publish(each: Recorded) -> None:
        await publishers[each.topic].publish(each.cdr)

    player = Player(args.file, summary, publish, args.rate, args.loop)
    beside = [asyncio.create_task(each) for each in await _tell_and_obey(guest, player)]
    await asyncio.sleep(SETTLING)
    print(f"playing {sum(summary.counts.values())} messages, {summary.seconds / args.rate:.1f} s", flush=True)
    if clock is not None:
        beside.append(asyncio.create_task(_tick(clock, player)))
    try:
        await player.run(until_end=not args.stay)
        await asyncio.sleep(SETTLING)
    finally:
        for task in beside:
            task.cancel()
    for publisher in publishers.values():
        await publisher.close()
    return 0


async def _tell_and_obey(guest: Guest, player: Player) -> list[Coroutine[None, None, None]]:
    """Return what publishes the state of a playback, and what carries out requests."""
    inside = await guest.add_interface("state", "PublisherInterface", playback.TYPE, playback.STATE, QOS)
    states = await guest.robot.publisher("state", playback.TYPE, to=inside, qos=QOS)
    inside = await guest.add_interface("control", "SubscriberInterface", playback.TYPE, playback.CONTROL, QOS)
    requests = await guest.robot.subscriber("control", playback.TYPE, to=inside, qos=QOS)

    async def tell() -> None:
        while True:
            await states.publish({"data": playback.encode(player.take_state())})
            with suppress(TimeoutError):
                await asyncio.wait_for(player.changed.wait(), playback.STATE_PERIOD)

    async def obey() -> None:
        async for message in requests:
            with suppress(*MALFORMED):  # anybody may publish there
                player.control(msgspec.json.decode(message["data"], type=playback.PlaybackRequest))

    return [tell(), obey()]


async def _publisher(guest: Guest, tag: str, topic: str, type_name: str) -> Publisher:
    inside = await guest.add_interface(tag, "PublisherInterface", type_name, topic, QOS)
    return await guest.robot.publisher(tag, type_name, to=inside, raw=True, qos=QOS)


async def _tick(clock: Publisher, player: Player) -> None:
    """Publish the time of the recording."""
    while True:
        await clock.publish(clock_message(player.time))
        await asyncio.sleep(CLOCK_PERIOD)


def clock_message(now: int) -> bytes:
    """Return the CDR of rosgraph_msgs/Clock for a time in ns since 1970."""
    seconds, nanoseconds = divmod(now, 1_000_000_000)
    return b"\0\1\0\0" + struct.pack("<iI", seconds, nanoseconds)


def info(session: ConsoleSession, args: argparse.Namespace) -> int:
    """Print what is in recordings; the status is 1 if one was cut off."""
    status = 0
    for path in args.files:
        summary = summarize(path)
        status |= not summary.complete
        if args.json:
            output.print_record(summary, as_json=True)
        else:
            print(info_text(str(path), summary))
    return status


def info_text(path: str, summary: Summary) -> str:
    """Return a description of a recording in lines."""
    lines = [
        f"file      {path}",
        f"size      {output.size_text(summary.size)}" + ("" if summary.complete else ", cut off: it has no end"),
        f"duration  {summary.seconds:.3f} s",
        f"start     {output.local_time(summary.start / 1e9)}",
        f"messages  {sum(summary.counts.values())}",
    ]
    width = max(map(len, summary.counts), default=0)
    for topic in {**summary.counts, **summary.dropped}:
        parts = [summary.types.get(topic, ""), f"{summary.dropped[topic]} dropped" if topic in summary.dropped else ""]
        lines.append(f"  {topic:{width}}  {summary.counts.get(topic, 0):8}  {', '.join(filter(None, parts))}")
    return "\n".join(lines)
