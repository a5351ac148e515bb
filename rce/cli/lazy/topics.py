"""Implementation of `topic echo|hz|bw|pub`, `service call` and `action send_goal`, by a guest in the environment."""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import statistics
import time
from collections import deque
from collections.abc import AsyncIterator, Iterable, Mapping
from itertools import pairwise
from typing import Any

import yaml

from rce.cli.commands.environments import yaml_value
from rce.cli.lazy.guest import Guest
from rce.cli.output import size_text
from rce.client import Robot, Subscriber
from rce.errors import InvalidRequest, NotFound, RceError, Unavailable
from rce.protocol.messages import Qos
from rce.protocol.names import TYPE, parse_type
from rce.spelling import did_you_mean

QUEUE_DEPTH = 1000  # messages that may wait to be printed
MAX_LENGTH = 128  # of arrays and strings that are printed in full, as by `ros2 topic echo`
INTERVAL = 1.0  # seconds between lines
NO_VALUES = "{}"
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
    """Publish a message once or repeatedly, as soon as the topic has a subscriber; the first error ends it."""
    args.type = await _type(guest, args, "topics")
    value = _parse_message(args.values)
    logging.getLogger("rce.client").setLevel(logging.ERROR)  # what it warns of is reported here
    failing = asyncio.create_task(_first_error(guest.robot))
    publishing = asyncio.create_task(_publish(guest, args, value))
    try:
        await asyncio.wait({failing, publishing}, return_when=asyncio.FIRST_COMPLETED)
        if failing.done():
            raise failing.result()
        await publishing
    finally:
        failing.cancel()
        publishing.cancel()
    return 0


async def _first_error(robot: Robot) -> RceError:
    """Wait for an error that the platform reports about a message, and return it."""
    async for event in robot.events():
        if isinstance(event, RceError):
            return event
    raise Unavailable("the connection was closed")


async def _publish(guest: Guest, args: argparse.Namespace, value: dict[str, Any]) -> None:
    count = 1 if args.once else args.times
    inside = await guest.add_interface("pub", "PublisherInterface", args.type, args.topic, QOS)
    publisher = await guest.robot.publisher("pub", args.type, to=inside, format="json")
    while not (topics := {each.name: each.subscribers for each in await guest.ros_names("topics")}).get(args.topic):
        print(waiting_text(args.topic, topics), flush=True)
        await asyncio.sleep(INTERVAL)
    number = 0
    while not count or number < count:
        number += 1
        if number > 1:
            await asyncio.sleep(1 / args.rate)
        await publisher.publish(value)
        print(f"publishing #{number}: {_yaml(value, flow=True)}", flush=True)
    await asyncio.sleep(INTERVAL)  # the interfaces must still exist when the last message passes them
    await publisher.close()  # its answer follows the errors of all messages


async def call(guest: Guest, args: argparse.Namespace) -> int:
    """Call a service and print the response."""
    type_name = await _type(guest, args, "services")
    inside = await guest.add_interface("call", "ServiceClientInterface", type_name, args.topic, Qos())
    client = await guest.robot.service_client("call", type_name, to=inside)
    _print(await client.call(_parse_message(args.values), args.timeout), args)
    return 0


async def send_goal(guest: Guest, args: argparse.Namespace) -> int:
    """Send a goal, and print its result; the goal is canceled when this ends before."""
    type_name = await _type(guest, args, "actions")
    inside = await guest.add_interface("ask", "ActionClientInterface", type_name, args.topic, Qos())
    client = await guest.robot.action_client("ask", type_name, to=inside)
    goal = await client.send_goal(_parse_message(args.values), timeout=args.timeout, cancel_if_lost=True)
    async for feedback in goal:
        if args.feedback:
            _print({"feedback": feedback}, args)
    result = await goal.result()
    _print({"status": result.status, "result": result.value}, args)
    return 0 if result.status == "succeeded" else 1


async def _subscriber(guest: Guest, args: argparse.Namespace, raw: bool) -> Subscriber:
    type_name = await _type(guest, args, "topics")
    inside = await guest.add_interface("sub", "SubscriberInterface", type_name, args.topic, QOS)
    robot = guest.robot
    return await robot.subscriber("sub", type_name, to=inside, raw=raw, depth=QUEUE_DEPTH, format="json", qos=QOS)


async def _type(guest: Guest, args: argparse.Namespace, kind: str) -> str:
    """Return the type that was given for a topic, service or action, or else the one that ROS has.

    Raises:
        InvalidRequest: ROS has another type than the one that was given.
        NotFound: None was given, and nothing in the environment has this name at present.
    """
    _take_values(args)
    if args.type:
        await _check_type(guest, args, kind)
        return str(args.type)
    names = {each.name: each.types for each in await guest.ros_names(kind)}
    if args.topic not in names:
        hint = did_you_mean(args.topic, names) or "give its type to wait for it"
        raise NotFound(f"there is no {kind[:-1]} {args.topic} in {guest.environment} at present: {hint}")
    return names[args.topic][0]


def _take_values(args: argparse.Namespace) -> None:
    """Read a message in the place of the type as the message: the type was left out."""
    if args.type and not TYPE.fullmatch(args.type) and getattr(args, "values", "") == NO_VALUES:
        args.type, args.values = "", args.type


async def _check_type(guest: Guest, args: argparse.Namespace, kind: str) -> None:
    """Check that ROS has the given type for a topic, service or action, if it has that name at present.

    Raises:
        InvalidRequest: ROS has another type.
    """
    types = next((each.types for each in await guest.ros_names(kind) if each.name == args.topic), [])
    if types and parse_type(args.type) not in map(parse_type, types):
        raise InvalidRequest(
            f"{kind[:-1]} {args.topic} of {guest.environment} has type {', '.join(types)}, not {args.type}",
            field="type",
        )


def waiting_text(topic: str, topics: Mapping[str, int]) -> str:
    """Return the line for a topic without subscribers, with the nearest one that has some; `topics` has their counts.

    Messages published before there is one are lost.
    """
    hint = did_you_mean(topic, (name for name, subscribers in topics.items() if subscribers))
    return f"waiting for a subscriber of {topic}" + (f"; {hint}" if hint else "")


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


def _print(value: Any, args: argparse.Namespace) -> None:
    print(json.dumps(value) if args.json else _yaml(value).rstrip(), flush=True)


def _yaml(value: Any, flow: bool = False) -> str:
    text: str = yaml.safe_dump(value, sort_keys=False, allow_unicode=True, default_flow_style=flow, width=10**9)
    return text.removesuffix("...\n") if not flow else text.strip()
