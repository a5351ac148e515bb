"""What `topic` and `service` do once the console takes part in an environment."""

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

from rce.client import Subscriber
from rce.console.environments import yaml_value
from rce.console.part import Part
from rce.console.show import amount
from rce.errors import InvalidRequest, NotFound
from rce.messages import Qos

DEPTH = 1000  # messages that may wait here
LONGEST = 128  # of arrays and strings that are printed whole, as by `ros2`
EVERY = 1.0  # seconds between lines
QOS = Qos(depth=100)


async def echo(part: Part, words: argparse.Namespace) -> int:
    subscriber = await _subscriber(part, words, raw=False)
    async for message in subscriber:
        value = _field(message, words.field)
        if words.json:
            print(json.dumps(value), flush=True)
        else:
            print(_yaml(shortened(value, words.no_arr, words.full_length)) + "---", flush=True)
        if words.once:
            break
    return 0


async def hz(part: Part, words: argparse.Namespace) -> int:
    times: deque[float] = deque(maxlen=words.window + 1)
    async for sizes in _arriving(await _subscriber(part, words, raw=True)):
        times.extend(when for when, _ in sizes)
        print(rate_text(times), flush=True)
    return 0


async def bw(part: Part, words: argparse.Namespace) -> int:
    window: deque[tuple[float, int]] = deque(maxlen=words.window)
    async for sizes in _arriving(await _subscriber(part, words, raw=True)):
        window.extend(sizes)
        print(bandwidth_text(window, time.monotonic()), flush=True)
    return 0


async def pub(part: Part, words: argparse.Namespace) -> int:
    value = _object(words.values)
    count = 1 if words.once else words.times
    inside = await part.interface("pub", "PublisherInterface", words.type, words.topic, QOS)
    publisher = await part.robot.publisher("pub", words.type, to=inside, format="json")
    while not await _has_subscribers(part, words.topic):
        print("waiting for a subscriber", flush=True)
        await asyncio.sleep(EVERY)
    number = 0
    while not count or number < count:
        number += 1
        if number > 1:
            await asyncio.sleep(1 / words.rate)
        await publisher.publish(value)
        print(f"publishing #{number}: {_yaml(value, flow=True)}", flush=True)
    await asyncio.sleep(EVERY)  # what was sent last is on its way while the interfaces are still there
    return 0


async def call(part: Part, words: argparse.Namespace) -> int:
    type_name = words.type or await _type(part, words.topic, "services")
    inside = await part.interface("call", "ServiceClientInterface", type_name, words.topic, Qos())
    client = await part.robot.service_client("call", type_name, to=inside)
    answer = await client.call(_object(words.values), words.timeout)
    print(json.dumps(answer) if words.json else _yaml(answer).rstrip())
    return 0


async def _subscriber(part: Part, words: argparse.Namespace, raw: bool) -> Subscriber:
    type_name = words.type or await _type(part, words.topic, "topics")
    inside = await part.interface("sub", "SubscriberInterface", type_name, words.topic, QOS)
    robot = part.robot
    return await robot.subscriber("sub", type_name, to=inside, raw=raw, depth=DEPTH, format="json", qos=QOS)


async def _type(part: Part, name: str, kind: str) -> str:
    """What ROS says in the environment. NotFound."""
    found = next((each for each in await part.names(kind) if each.name == name), None)
    if found is None:
        raise NotFound(f"there is no {kind[:-1]} {name} in {part.environment} at present; give its type to wait for it")
    return found.types[0]


async def _has_subscribers(part: Part, topic: str) -> bool:
    """Whether a node listens; what is published before is lost."""
    return any(each.name == topic and each.subscribers for each in await part.names("topics"))


async def _arriving(subscriber: Subscriber) -> AsyncIterator[list[tuple[float, int]]]:
    """Times and sizes of the messages of each second, of seconds that have some."""
    found: list[tuple[float, int]] = []

    async def take() -> None:
        async for message in subscriber:
            found.append((time.monotonic(), len(message)))  # noqa: PERF401  # others look at it meanwhile

    taking = asyncio.create_task(take())
    try:
        while not taking.done():
            await asyncio.wait([taking], timeout=EVERY)
            if found:
                yield found[:]
                found.clear()
        taking.result()
    finally:
        taking.cancel()


def rate_text(times: Iterable[float]) -> str:
    """The lines of `ros2 topic hz`."""
    arrivals = list(times)
    gaps = [after - before for before, after in pairwise(arrivals)]
    if not gaps:
        return "one message so far"
    return (
        f"average rate: {len(gaps) / sum(gaps):.3f}\n\tmin: {min(gaps):.3f}s max: {max(gaps):.3f}s "
        f"std dev: {statistics.pstdev(gaps):.5f}s window: {len(gaps)}"
    )


def bandwidth_text(messages: Iterable[tuple[float, int]], now: float) -> str:
    """The lines of `ros2 topic bw`."""
    found = list(messages)
    sizes = [size for _, size in found]
    rate = sum(sizes) / max(now - found[0][0], EVERY)
    return (
        f"{amount(rate)}/s from {len(sizes)} messages\n\tMessage size mean: {amount(statistics.fmean(sizes))} "
        f"min: {amount(min(sizes))} max: {amount(max(sizes))}"
    )


def shortened(value: Any, no_arrays: bool = False, full: bool = False) -> Any:
    """A message with long arrays and strings cut, or with no arrays at all."""
    match value:
        case dict():
            return {key: shortened(each, no_arrays, full) for key, each in value.items()}
        case list() if no_arrays:
            return f"<array of {len(value)}>"
        case list():
            cut = value if full else value[:LONGEST]
            dots = ["..."] if len(cut) < len(value) else []
            return [*(shortened(each, no_arrays, full) for each in cut), *dots]
        case str() if len(value) > LONGEST and not full:
            return value[:LONGEST] + "..."
        case bytes():
            return f"<{len(value)} bytes>"
    return value


def _field(message: Any, path: str) -> Any:
    for name in filter(None, path.split(".")):
        if not isinstance(message, dict) or name not in message:
            raise InvalidRequest(f"the messages have no field {path!r}: {name!r} is missing", field="field")
        message = message[name]
    return message


def _object(text: str) -> dict[str, Any]:
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
