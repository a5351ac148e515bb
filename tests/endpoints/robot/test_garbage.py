"""Malformed frames of every kind from a robot: each gets an error, and other robots are not affected.

`RCE_GARBAGE` is the number of frames (5000). The Robot endpoint is a process of its own to measure its memory.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import random
import time
from collections.abc import Callable, Iterator

import psutil
import pytest

from tests.support.endpoints.platforms import Processes
from tests.support.endpoints.raw_robot import Robot, dm, eventually, status

pytestmark = pytest.mark.slow  # sends thousands of frames

COUNT = int(os.environ.get("RCE_GARBAGE", "5000"))
MEMORY = 20 * 1024 * 1024
WINDOW = 50  # unanswered frames

Frame = str | bytes
Make = Callable[[random.Random], Frame]


def _dm(**fields: object) -> str:
    data = {"iTag": "out", "type": "std_msgs/String", "msgID": "nil", "msg": {"data": "x"}} | fields
    return json.dumps({"type": "DM", "data": {key: value for key, value in data.items() if value is not None}})


def _cut(rng: random.Random) -> str:
    whole = _dm(msg={"data": "x" * rng.randrange(50)})
    return whole[: rng.randrange(len(whole) - 1)]


def _mutated(rng: random.Random) -> bytes:
    frame = bytearray(_dm().encode())
    frame[0] = rng.randrange(32)
    for _ in range(rng.randrange(1, 5)):
        frame[rng.randrange(len(frame))] = rng.randrange(256)
    return bytes(frame)


def _hex(rng: random.Random) -> str:
    return f"{rng.getrandbits(128):032x}"


def _typed(rng: random.Random) -> object:
    return rng.choice([None, True, -1, 1e308, 10**400, "", "\x00", "x" * 5000, [], [[]], {}, {"": {}}, [1, "a", None]])


def _command(rng: random.Random) -> str:
    kind = rng.choice(["CC", "DC", "CN", "CX"])
    lists = ["addNodes", "removeNodes", "addInterfaces", "removeInterfaces", "setParam", "deleteParam", "addRecorders"]
    lists += ["removeRecorders", "connect"]
    data: dict[str, object] = {rng.choice(lists): rng.choice([_typed(rng) or 1, [_typed(rng)], [{"tagA": "a"}]])}
    if kind in ("CC", "DC"):
        data = {"containerTag": rng.choice([None, 5, [], {}]), "containerData": _typed(rng)}
    elif kind == "CX":
        data = {"connect": [rng.choice([{"tagA": "a", "tagB": "b"}, {"tagA": 1}, 5, {}])]}
    else:
        data = {rng.choice(lists[:6]): [rng.choice([5, {}, {"containerTag": 1}, {"endpointTag": _typed(rng)}])]}
    return json.dumps({"type": kind, "data": data})


def _deep(rng: random.Random) -> str:
    depth = rng.choice([100, 1100, 20_000])
    opened = rng.choice(["[", '{"a":'])
    value = opened * depth + "1" + {"[": "]", '{"a":': "}"}[opened] * depth
    return rng.choice(
        [
            '{"type":"DM","data":' + value + "}",
            '{"type":"DM","data":{"iTag":"out","type":"std_msgs/String","msgID":"nil","msg":{"data":' + value + "}}}",
        ]
    )


SYNCHRONOUS: dict[str, Make] = {
    "cut JSON": _cut,
    "not JSON": lambda rng: "".join(chr(rng.randrange(32, 0x2FF)) for _ in range(rng.randrange(1, 200))) + "{",
    "no object": lambda rng: rng.choice(["1", "null", "[]", '"x"', "NaN", "-Infinity", "[NaN]", "{}", ""]),
    "bad bytes": _mutated,
    "invalid UTF-8": lambda rng: b'\x01{"type":"DM","data":{"iTag":"\xff\xfe","type":"a/b","msgID":"n","msg":{}}}',
    "lone surrogate": lambda rng: _dm(iTag="\ud800"),
    "unknown type": lambda rng: json.dumps({"type": rng.choice(["XX", "ST", "ER", "", "dm"]), "data": _typed(rng)}),
    "wrong field": lambda rng: _dm(
        **{rng.choice(["iTag", "type", "msgID"]): rng.choice([None, 5, [], {}, True, "x" * 3000])}
    ),
    "wrong message": lambda rng: _dm(msg=rng.choice([5, [], "x", {"data": 5}, {"data": []}, {"data": {}}, True])),
    "huge number": lambda rng: _dm(
        iTag="num", type="std_msgs/Int8", msg={"data": rng.choice([10**30, -(10**30), 1e300])}
    ),
    "deep": _deep,
    "unknown interface": lambda rng: _dm(iTag=f"i{rng.randrange(10**6)}"),
    "wrong direction": lambda rng: _dm(iTag="in"),
    "unknown call": lambda rng: _dm(iTag="serve", type="std_srvs/Trigger", msgID=_hex(rng), msg={"success": True}),
    "bad blob reference": lambda rng: _dm(msg=None, **{"msg*": rng.choice([5, "x", "f" * 31, ["x"], {}, None, [[]]])}),
    "short blob": lambda rng: b"\x02" + rng.randbytes(rng.randrange(0, 31)),
    "no blob id": lambda rng: b"\x02" + b"z" * 32 + rng.randbytes(rng.randrange(0, 100)),
    "bad command": _command,
}
"""Frames by kind that are answered at once by one ER. Bytes begin with their opcode."""

UNFINISHED: dict[str, Make] = {
    "frame without blob": lambda rng: _dm(msg=None, **{"msg*": _hex(rng)}),
    "blob without frame": lambda rng: b"\x02" + _hex(rng).encode() + rng.randbytes(rng.randrange(200_000)),
    "frame without blobs": lambda rng: _dm(msg={"list": [{"x*": _hex(rng)} for _ in range(rng.randrange(1, 100))]}),
}
"""Frames by kind that are counted, and answered by an ER when they are dropped as too old or too many."""


def garbage(rng: random.Random) -> Iterator[tuple[str, Frame]]:
    kinds = list(SYNCHRONOUS) * 2 + list(UNFINISHED)
    for number in itertools.count():
        kind = kinds[number % len(kinds)]
        yield kind, (SYNCHRONOUS.get(kind) or UNFINISHED[kind])(rng)


async def send(robot: Robot, frame: Frame) -> None:
    if isinstance(frame, bytes):
        text, payload = frame[0] == 1 or frame[0] > 2, frame[1:]
        await robot.socket.send(payload, text=text)
    else:
        await robot.socket.send(frame.encode("utf-8", "surrogatepass"), text=True)


async def round_trips(one: Robot, other: Robot, until: asyncio.Event, took: list[float]) -> None:
    while not until.is_set():
        began = time.perf_counter()
        await one.data("ping", {"data": "p"})
        assert (await other.receive())["type"] == "DM"
        took.append(time.perf_counter() - began)
        await asyncio.sleep(0.002)


def p99(took: list[float]) -> float:
    return sorted(took)[int(len(took) * 0.99)] * 1e3


async def connected_pair(processes: Processes) -> tuple[Robot, Robot]:
    one, other = await processes.robot("one"), await processes.robot("other")
    await one.add("ping", "SubscriberConverter")
    await one.add("ping", "PublisherConverter", of="other")
    await one.connect("one/ping", "other/ping")
    assert await one.receive() == status("ping", True)
    assert await other.receive() == status("ping", True)
    return one, other


async def attacker(processes: Processes) -> Robot:
    robot = await processes.robot("attacker")
    await robot.add("out", "SubscriberConverter")
    await robot.add("num", "SubscriberConverter", "std_msgs/Int8")
    await robot.add("in", "PublisherConverter")
    await robot.add("serve", "ServiceClientConverter", "std_srvs/Trigger")
    await robot.connect("attacker/out", "attacker/in")
    await robot.until(lambda frame: frame == status("out", True))  # the receiving side gets its status first
    return robot


class Trial:
    """Sends garbage with a limited number of unanswered frames."""

    def __init__(self, robot: Robot, seed: int) -> None:
        self.robot = robot
        self.sent: dict[str, int] = {}
        self.answered = 0
        self._wanted = 0
        self._rng = random.Random(seed)

    async def run(self, count: int) -> None:
        reader = asyncio.create_task(self._read())
        try:
            for kind, frame in itertools.islice(garbage(self._rng), count):
                if kind in SYNCHRONOUS:
                    self._wanted += 1
                self.sent[kind] = self.sent.get(kind, 0) + 1
                await send(self.robot, frame)
                await asyncio.sleep(0)  # the other robots are in this process
                while self._wanted - self.answered > WINDOW:
                    await asyncio.wait({reader}, timeout=0.001)
                    if reader.done():
                        reader.result()
            await eventually(lambda: self.answered >= self._wanted)
        finally:
            reader.cancel()

    async def _read(self) -> None:
        while True:
            frame = json.loads(await self.robot.socket.recv())
            assert frame["type"] == "ER", frame
            assert frame["data"], "an error has a text"
            self.answered += 1


async def test_garbage_gets_errors_and_affects_no_other_robot(
    processes: Processes, capsys: pytest.CaptureFixture[str]
) -> None:
    control = await processes.start_master()
    await processes.start_robot(control, "--bad-messages", "0")
    one, other = await connected_pair(processes)
    robot = await attacker(processes)
    process = psutil.Process(processes.process("endpoints.robot").pid)
    await Trial(robot, 1).run(500)  # fill the caches
    over = asyncio.Event()
    quiet: list[float] = []
    asyncio.get_running_loop().call_later(min(2.0, COUNT / 5000), over.set)
    await round_trips(one, other, over, quiet)
    before = process.memory_info().rss

    over = asyncio.Event()
    noisy: list[float] = []
    traffic = asyncio.create_task(round_trips(one, other, over, noisy))
    trial = Trial(robot, 2)
    began = time.perf_counter()
    await trial.run(COUNT)
    seconds = time.perf_counter() - began
    over.set()
    await traffic

    grown = process.memory_info().rss - before
    with capsys.disabled():
        print(
            f"\n{COUNT} malformed frames in {seconds:.1f} s, {trial.answered} answers, memory {grown / 2**20:+.1f} MB; "
            f"others' p99 {p99(quiet):.2f} ms quiet, {p99(noisy):.2f} ms meanwhile"
        )
    assert grown < MEMORY
    await robot.send(dm("out", {"data": "still here"}))
    (*_, last) = await robot.until(lambda frame: frame["type"] == "DM")
    assert last == dm("in", {"data": "still here"})
    assert "defect" not in processes.log("endpoints.robot")


async def test_socket_is_closed_after_too_many_bad_messages(processes: Processes) -> None:
    control = await processes.start_master()
    await processes.start_robot(control)
    robot = await processes.robot("attacker")
    for _ in range(101):
        await robot.send("{")
    code, reason = await robot.closed()
    assert code == 1008
    assert "100 bad messages" in reason
