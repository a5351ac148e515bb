"""One subscription of a topic for all interfaces of an environment that want it with the same quality of service.

A message goes once to each link, with the ids of all interfaces whose peers are behind it. So fifty viewers of a camera
cost one subscription in ROS, and one copy of each image on the way to their Robot endpoint.
"""

from __future__ import annotations

import asyncio
import itertools
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from secrets import token_bytes, token_hex
from time import perf_counter
from typing import Protocol

from endpoints.data.frames import MAX_SENDERS, Buffer, Message
from endpoints.data.link import Link
from endpoints.environment.discovery import after_discovery
from endpoints.environment.ros import Ros
from endpoints.environment.ros_topics import RawSubscription, Taken, Topic
from endpoints.environment.shared_topics import SharedTopics, topic_key
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import InvalidRequest, LimitExceeded, RceError
from rce.net.budget import INTERFACE, Budget
from rce.protocol.messages import Qos
from rce.protocol.messages.commands import SHALLOW

MAX_LATCHED = 100  # publishers of a latched topic whose last messages are kept for late robots


class Member(Protocol):
    """An interface that wants the topic."""

    id: bytes
    spec: InterfaceSpec
    peers: dict[bytes, Link]

    def sent(self, size: int) -> None:
        """Count a message to the peers."""

    def lost(self, count: int, link: Link | None) -> None:
        """Count messages that were dropped, on the way to a link or before."""

    def refused(self, error: RceError) -> None:
        """Report an error to the owner of the interface."""


Create = Callable[[Callable[[], RawSubscription]], RawSubscription]
"""Runs a function; raises InvalidRequest for what ROS refuses."""


class SharedSubscription:
    """A subscription and its members.

    The last messages of latched publishers are kept for late peers.

    Attributes:
        id: Source of its messages in the queues of links.
        spec: The first member's.
        budget: Bytes that its messages may hold while they wait.
    """

    subscription: RawSubscription

    def __init__(self, ros: Ros, spec: InterfaceSpec, qos: Qos, keep: int | None, within: Budget) -> None:
        self.id = token_bytes(16)
        self.spec = spec
        self.budget = Budget(INTERFACE, within, spare=1)
        self.members: list[Member] = []
        self._discovery: asyncio.Future[None] | None = None  # done when the publishers have discovered it
        self._ros = ros
        self._qos = qos
        self._keep = keep
        self._links: set[Link] = set()
        self._reasons: list[str] = []  # for which a node and this subscription do not match
        prefix = token_hex(8)
        self._names = (f"{prefix}{number:016x}" for number in itertools.count())  # ids of messages
        self._latched: dict[bytes, deque[bytes]] = {}  # by publisher
        self._latched_size = 0
        self._latched_depth = (spec.qos.depth or SHALLOW) if spec.qos.durability == "transient_local" else 1

    async def open(self, kind: type[object], create: Create) -> None:
        """Create the ROS entity for the first member, and wait until its publishers have discovered it."""
        if not hasattr(self, "subscription"):
            topic = Topic(kind, self.spec.addr, self._qos, self._mismatch)
            self.subscription = create(lambda: RawSubscription(self._ros, topic, self._take, self.evicted))
            if self.subscription.had_publishers:
                self._discovery = self._discovered()
        if self._discovery is not None:
            # Messages that they publish before they discover the subscription would be lost after the status is true.
            await asyncio.shield(self._discovery)

    def _discovered(self) -> asyncio.Future[None]:
        """Return a future that is done when the publishers have discovered the subscription."""
        done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        ros, publishers = self._ros, self.subscription.publishers
        after_discovery(ros, publishers, lambda: done.set_result(None))
        return done

    def add(self, member: Member) -> None:
        """Add a member, which gets what the others get as soon as it has a peer."""
        self.members.append(member)
        for reason in self._reasons:
            self._refuse(member, reason)

    def peers_changed(self) -> None:
        """Take messages while a member has a peer, and drop those for links that no member uses any more."""
        links = {link for member in self.members for link in member.peers.values()}
        for gone in self._links - links:
            gone.discard(self.id)
        before, self._links = bool(self._links), links
        if bool(links) != before:
            (self.subscription.start if links else self.subscription.pause)()

    def send_latched(self, member: Member, peer: bytes) -> None:
        """Send the kept messages of latched publishers to a new peer."""
        for messages in self._latched.values():
            for payload in messages:
                self._send(payload, destination=peer, members=[member])

    def receive_shared(self, message: Message, link: Link, latched: bool) -> None:
        """Send a message that another interface of the environment publishes.

        What came from an environment goes to robots only: environments that are connected in a circle would pass a
        message on for ever.
        """
        payload = bytes(message.payload)
        if latched or self.subscription.latched:
            self._keep_latched(payload, message.source)
        self._send(payload, robots_only=link.to_environment)
        room = self._wait_for_room()
        if room is not None:
            link.pause(room)

    def close(self) -> None:
        """Destroy the subscription."""
        for link in self._links:
            link.discard(self.id)
        self.subscription.destroy()

    # --- from ROS -----------------------------------------------------------------------------------------------------

    def _take(self, batch: Sequence[Taken]) -> bool:
        """Send messages to the links; return False to pause until the links have room."""
        since = perf_counter()
        links = tuple(self._links) if len(batch) > 1 else ()
        for link in links:
            link.gather()
        try:
            for payload, publisher in batch:
                self._handle_one(payload, publisher, since)
        finally:
            for link in links:
                link.flush()
        room = self._wait_for_room()
        if room is None:
            return True
        room.add_done_callback(lambda _: self._resume())
        return False

    def _mismatch(self, reason: str) -> None:
        """Report a node that does not match."""
        self._reasons.append(reason)
        for member in self.members:
            self._refuse(member, reason)

    def _refuse(self, member: Member, reason: str) -> None:
        member.refused(InvalidRequest(f"interface {member.spec.tag}: {reason}"))

    def _handle_one(self, payload: bytes, publisher: bytes, since: float) -> None:
        if self.subscription.latched:
            self._keep_latched(payload, publisher)
        try:
            if len(self.members) == len(self._links) == 1:
                self._send_to_one(payload, since)
            else:
                self._send(payload, since=since)
        except LimitExceeded as error:
            self.evicted(1)
            for member in self.members:
                member.refused(error)

    def _resume(self) -> None:
        """Continue to take messages as soon as the links have room."""
        room = self._wait_for_room()
        if room is not None:
            room.add_done_callback(lambda _: self._resume())
        elif self._links:
            self.subscription.resume()

    # --- to the links -------------------------------------------------------------------------------------------------

    def _send_to_one(self, payload: Buffer, since: float) -> None:
        """Do what `_send` does, in less time, for the usual case: one interface with its peers behind one link."""
        (member,), (link,) = self.members, self._links
        message = Message(self.id, next(self._names), payload, senders=(member.id,), entered_at=since)
        dropped = link.send(message, self._keep, self)
        if dropped:
            member.lost(dropped, link)
        member.sent(len(payload))

    def _send(
        self,
        payload: Buffer,
        *,
        destination: bytes | None = None,
        members: list[Member] | None = None,
        robots_only: bool = False,
        since: float = 0.0,
    ) -> None:
        since = since or perf_counter()
        wanted = self.members if members is None else members
        name = next(self._names)
        got: set[bytes] = set()
        for link in self._links_of(wanted, destination):
            if robots_only and link.to_environment:
                continue
            behind = [each for each in wanted if link in each.peers.values()]
            for some in _chunks(behind):
                senders = tuple(each.id for each in some)
                message = Message(self.id, name, payload, destination, senders=senders, entered_at=since)
                dropped = link.send(message, self._keep, self)
                got.update(senders)
                if dropped:
                    for each in some:
                        each.lost(dropped, link)
        for each in wanted:
            if each.id in got:
                each.sent(len(payload))

    def _links_of(self, members: list[Member], destination: bytes | None) -> set[Link]:
        """Return the links to all peers of members, or to one of them."""
        peers = [(peer, link) for each in members for peer, link in each.peers.items()]
        return {link for peer, link in peers if destination in (None, peer)}

    def evicted(self, count: int) -> None:
        """Count messages that were dropped before they reached a link, or because a budget was exceeded."""
        for member in self.members:
            if member.peers:
                member.lost(count, None)

    def _wait_for_room(self) -> asyncio.Future[None] | None:
        """Return None while more may be sent, else a future that is done when it may; only with `keep_all`."""
        if self._keep is None:
            for link in self._links:
                waiting = link.wait_for_room(self.id)
                if waiting is not None:
                    return waiting
        return None

    # --- latched ------------------------------------------------------------------------------------------------------

    def _keep_latched(self, payload: bytes, publisher: bytes) -> None:
        kept = self._latched[publisher] = self._latched.pop(publisher, deque())  # the last of the publishers now
        kept.append(payload)
        self._latched_size += len(payload)
        if len(kept) > self._latched_depth:
            self._latched_size -= len(kept.popleft())
        while len(self._latched) > MAX_LATCHED or self._latched_size > max(INTERFACE, len(payload)):
            self._forget_latched()

    def _forget_latched(self) -> None:
        """Forget the oldest message of the publisher that has not published for the longest time."""
        publisher, kept = next(iter(self._latched.items()))
        self._latched_size -= len(kept.popleft())
        if not kept:
            del self._latched[publisher]


def _chunks(members: list[Member]) -> Iterator[list[Member]]:
    rest = iter(members)
    while some := list(itertools.islice(rest, MAX_SENDERS)):
        yield some


class SharedSubscriptions:
    """The subscriptions of an environment, by topic, type and quality of service.

    A subscription that must not drop messages (`keep_all`) has one member: it waits for the slowest link.
    """

    def __init__(self, ros: Ros, shared: SharedTopics, budget: Budget) -> None:
        self._ros = ros
        self._shared = shared
        self._budget = budget
        self._by_key: dict[tuple[object, ...], SharedSubscription] = {}

    async def join(
        self, member: Member, qos: Qos, keep: int | None, kind: type[object], create: Create
    ) -> SharedSubscription:
        """Return the subscription of a new member, which is created with the first one.

        Args:
            member: The member.
            qos: Its quality of service.
            keep: Number of messages that may wait for a link, the newest; None for all.
            kind: Class of the messages.
            create: Creates the ROS entity.

        Raises:
            InvalidRequest: `addr` is not a valid ROS name.
        """
        key = (*topic_key(member.spec), qos, member.id if keep is None else b"")
        found = self._by_key.get(key)
        if found is None:
            found = self._by_key[key] = SharedSubscription(self._ros, member.spec, qos, keep, self._budget)
        found.add(member)
        try:
            await found.open(kind, create)
        except BaseException:
            self.leave(member, found)
            raise
        if found not in self._shared.receivers_of(member.spec):
            self._shared.add(found)
        return found

    def leave(self, member: Member, subscription: SharedSubscription) -> None:
        """Remove a member; the subscription ends with the last one."""
        if member not in subscription.members:
            return
        subscription.members.remove(member)
        if subscription.members:
            return
        self._by_key = {key: each for key, each in self._by_key.items() if each is not subscription}
        self._shared.remove(subscription)
        if hasattr(subscription, "subscription"):
            subscription.close()
