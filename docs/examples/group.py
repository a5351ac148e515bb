"""Two environments in one network group: their nodes see each other as one ROS 2 graph.

Run it beside `rce up --dev`:

    python docs/examples/group.py [URL]

The node `echo` runs in one environment; the robot talks to it through the other one. With the engine `docker` the two
are containers in a private network, with `process` they share a ROS domain.
"""

import asyncio
import sys
from contextlib import suppress

from rce.client import Robot
from rce.errors import TimedOut

URL = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:9000/"


async def main() -> None:
    async with (
        Robot(URL, user="testUser", robot="pair", password="testUser") as robot,
        robot.environment("group_worker", group="pair") as worker,
        robot.environment("group_front", group="pair") as front,
    ):
        await worker.add_node("echo", "rce_demo", "echo")
        heard = await front.subscriber("/heard", "std_msgs/String")
        say = await front.publisher("/say", "std_msgs/String")
        for _ in range(100):  # ROS 2 takes a moment until the node and the publisher know each other
            await say.publish({"data": "hello from the other environment"})
            with suppress(TimedOut):
                print((await heard.get(timeout=0.2))["data"])
                break


asyncio.run(main())
