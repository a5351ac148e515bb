"""Implementation of `topic echo|hz|bw|pub` and `service call`, by a guest in the environment."""

from __future__ import annotations

import argparse
import asyncio
import json
import statistics
import time
from collections import deque
from collections.abc import AsyncIterator, Iterable
from itertools import pairwise
from typing import Any

import yaml

from rce.cli.commands.environments import yaml_value
from rce.cli.lazy.guest import Guest
from rce.cli.output import size_text
from rce.client import Subscriber
from rce.errors import InvalidRequest, NotFound
from rce.protocol.messages import Qos

QUEUE_DEPTH = 1000  # messages that may wait to be printed
MAX_LENGTH = 128  # of arrays and strings that are printed in full, as by `ros2 topic echo`
INTERVAL = 1.0  # seconds between lines
QOS = Qos(depth=100)


async def echo(guest: Guest, args: argparse.Namespace) -> int:
    """Print the messages of a topic."""
    subscriber = await _subscriber(guest, args, raw=False)
    async for message in subscriber:
        value = _field(message, args.field)
        if args.json:
            print(json.dumps(value), flush=True)
        else:
            print(_yaml(shorten(value, args.no_arr, args.full_length)) + "---", flush=True)
        if args.once:
            break
    return 0


async def hz(guest: Guest, args: argparse.Namespace) -> int:
    """Print the rate of a topic's messages."""
    times: deque[float] = deque(maxlen=args.window + 1)
    async for arrivals in _arrivals(await _subscriber(guest, args, raw=True)):
        times.extend(arrival for arrival, _ in arrivals)
        print(rate_text(times), flush=True)
    return 0


async def bw(guest: Guest, args: argparse.Namespace) -> int:
    """Print the bandwidth of a topic's messages."""
    window: deque[tuple[float, int]] = deque(maxlen=args.window)
    async for arrivals in _arrivals(await _subscriber(guest, args, raw=True)):
        window.extend(arrivals)
        print(bandwidth_text(window, time.monotonic()), flush=True)
    return 0


async def pub(guest: Guest, args: argparse.Namespace) -> int:
    """Publish a message once or repeatedly, as soon as the topic has a subscriber."""
    value = _parse_message(args.values)
    count = 1 if args.once else args.times
    inside = await guest.add_interface("pub", "PublisherInterface", args.type, args.topic, QOS)
    publisher = await guest.robot.publisher("pub", args.type, to=inside, format="json")
    while not await _has_subscribers(guest, args.topic):
        print("waiting for a subscriber", flush=True)
        await asyncio.sleep(INTERVAL)
    number = 0
    while not count or number < count:
        number += 1
        if number > 1:
            await asyncio.sleep(1 / args.rate)
        await publisher.publish(value)
        print(f"publishing #{number}: {_yaml(value, flow=True)}", flush=True)
    await asyncio.sleep(INTERVAL)  # the interfaces must still exist when the last message passes them
    return 0


async def call(guest: Guest, args: argparse.Namespace) -> int:
    """Call a service and print the response."""
    type_name = args.type or await _type_of(guest, args.topic, "services")
    inside = await guest.add_interface("call", "ServiceClientInterface", type_name, args.topic, Qos())
    client = await guest.robot.service_client("call", type_name, to=inside)
    response = await client.call(_parse_message(args.values), args.timeout)
    print(json.dumps(response) if args.json else _yaml(response).rstrip())
    return 0


async def _subscriber(guest: Guest, args: argparse.Namespace, raw: bool) -> Subscriber:
    type_name = args.type or await _type_of(guest, args.topic, "topics")
    inside = await guest.add_interface("sub", "SubscriberInterface", type_name, args.topic, QOS)
    robot = guest.robot
    return await robot.subscriber("sub", type_name, to=inside, raw=raw, depth=QUEUE_DEPTH, format="json", qos=QOS)


async def _type_of(guest: Guest, name: str, kind: str) -> str:
    """Return the type that ROS has for a topic or service.

    Raises:
        NotFound: Nothing in the environment has this name at present.
    """
    found = next((each for each in await guest.ros_names(kind) if each.name == name), None)
    if found is None:
        raise NotFound(
            f"there is no {kind[:-1]} {name} in {guest.environment} at present; give its type to wait for it"
        )
    return found.types[0]


async def _has_subscribers(guest: Guest, topic: str) -> bool:
    """Return True if a node subscribes to the topic; messages published before that are lost."""
    return any(each.name == topic and each.subscribers for each in await guest.ros_names("topics"))


async def _arrivals(subscriber: Subscriber) -> AsyncIterator[list[tuple[float, int]]]:
    """Yield the arrival times and sizes of each second's messages; skips seconds without messages."""
    arrivals: list[tuple[float, int]] = []

    async def receive() -> None:
        async for message in subscriber:
            arrivals.append((time.monotonic(), len(message)))  # noqa: PERF401  # read below before the loop ends

    receiving = asyncio.create_task(receive())
    try:
        while not receiving.done():
            await asyncio.wait([receiving], timeout=INTERVAL)
            if arrivals:
                yield arrivals[:]
                arrivals.clear()
        receiving.result()
    finally:
        receiving.cancel()


def rate_text(times: Iterable[float]) -> str:
    """Return the rate of arrivals (seconds) in the format of `ros2 topic hz`."""
    arrivals = list(times)
    gaps = [after - before for before, after in pairwise(arrivals)]
    if not gaps:
        return "one message so far"
    return (
        f"average rate: {len(gaps) / sum(gaps):.3f}\n\tmin: {min(gaps):.3f}s max: {max(gaps):.3f}s "
        f"std dev: {statistics.pstdev(gaps):.5f}s window: {len(gaps)}"
    )


def bandwidth_text(messages: Iterable[tuple[float, int]], now: float) -> str:
    """Return the bandwidth of messages (arrival in seconds, size in bytes) in the format of `ros2 topic bw`."""
    found = list(messages)
    sizes = [size for _, size in found]
    rate = sum(sizes) / max(now - found[0][0], INTERVAL)
    return (
        f"{size_text(rate)}/s from {len(sizes)} messages\n\tMessage size mean: {size_text(statistics.fmean(sizes))} "
        f"min: {size_text(min(sizes))} max: {size_text(max(sizes))}"
    )


def shorten(value: Any, no_arrays: bool = False, full: bool = False) -> Any:
    """Return a message with long arrays and strings cut; with `no_arrays` only the lengths of arrays."""
    match value:
        case dict():
            return {key: shorten(each, no_arrays, full) for key, each in value.items()}
        case list() if no_arrays:
            return f"<array of {len(value)}>"
        case list():
            cut = value if full else value[:MAX_LENGTH]
            dots = ["..."] if len(cut) < len(value) else []
            return [*(shorten(each, no_arrays, full) for each in cut), *dots]
        case str() if len(value) > MAX_LENGTH and not full:
            return value[:MAX_LENGTH] + "..."
        case bytes():
            return f"<{len(value)} bytes>"
    return value


def _field(message: Any, path: str) -> Any:
    for name in filter(None, path.split(".")):
        if not isinstance(message, dict) or name not in message:
            raise InvalidRequest(f"the messages have no field {path!r}: {name!r} is missing", field="field")
        message = message[name]
    return message


def _parse_message(text: str) -> dict[str, Any]:
    value = yaml_value(text)
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise InvalidRequest(
            f"{text!r} is not a message: write its fields as YAML, as '{{data: hello}}'", field="values"
        )
    return value


def _yaml(value: Any, flow: bool = False) -> str:
    text: str = yaml.safe_dump(value, sort_keys=False, allow_unicode=True, default_flow_style=flow, width=10**9)
    return text.removesuffix("...\n") if not flow else text.strip()
