"""Two robots that exchange messages directly, without an environment.

Run it twice beside `rce up --dev`, in two terminals, in any order:

    python docs/examples/two_robots.py rover [URL]
    python docs/examples/two_robots.py lander [URL]

The rover sends its pose. The lander connects its own interface to the rover's as soon as the rover is there.
"""

import asyncio
import sys

from rce.client import Robot, Subscriber
from rce.errors import NotFound

ROLE = sys.argv[1]
URL = sys.argv[2] if len(sys.argv) > 2 else "http://127.0.0.1:9000/"


async def rover(robot: Robot) -> None:
    poses = await robot.publisher("pose", "geometry_msgs/Pose2D")
    for number in range(5):
        await poses.publish({"x": number * 0.5, "y": 0.0, "theta": 0.0}, timeout=30)  # waits for the lander


async def lander(robot: Robot) -> None:
    poses = await find(robot)
    for _ in range(5):
        pose = await poses.get(timeout=10)
        print(f"the rover is at x = {pose['x']:.1f}")


async def find(robot: Robot) -> Subscriber:
    while True:
        try:
            return await robot.subscriber("pose", "geometry_msgs/Pose2D", to="rover/pose")
        except NotFound:  # the rover is not there yet
            await asyncio.sleep(0.2)


async def main() -> None:
    async with Robot(URL, user="testUser", robot=ROLE, password="testUser") as robot:
        await {"rover": rover, "lander": lander}[ROLE](robot)


asyncio.run(main())
