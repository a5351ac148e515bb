"""Publish on a topic of an environment, and subscribe to another one.

Run it beside `rce up --dev`:

    python docs/examples/topic.py [URL]

The environment has one ROS 2 node, which publishes each message of /say on /heard (containers/nodes/rce_demo/echo.py).
"""

import asyncio
import sys

from rce.client import Robot

URL = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:9000/"


async def main() -> None:
    async with (
        Robot(URL, user="testUser", robot="talker", password="testUser") as robot,
        robot.environment("topic_example") as brain,
    ):
        await brain.add_node("echo", "rce_demo", "echo")
        say = await brain.publisher("/say", "std_msgs/String")
        heard = await brain.subscriber("/heard", "std_msgs/String")
        for number in range(3):
            await say.publish({"data": f"hello {number}"})
            message = await heard.get(timeout=10)
            print(message["data"])


asyncio.run(main())
