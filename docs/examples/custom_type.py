"""Use a message type of your own: push its ROS package, and start an environment that has the package.

Run it beside `rce up --dev`. Building the type takes g++ and ROS 2 on this machine.
`provisioning/provision demo` installs ROS 2 (elsewhere `pip install -e '.[ros]'` in a checkout):

    RCE_PASSWORD=testUser rce package push docs/examples/weather
    python docs/examples/custom_type.py [URL]

The package `weather` has the message type weather/Reading and a node that publishes the mean of all temperatures on
/mean. The robot itself needs neither the package nor ROS.
"""

import asyncio
import sys

from rce.client import Robot

URL = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:9000/"


async def main() -> None:
    async with (
        Robot(URL, user="testUser", robot="station", password="testUser") as robot,
        robot.environment("custom_type_example", packages=["weather"]) as brain,
    ):
        await brain.add_node("mean", "weather", "mean.py")
        readings = await brain.publisher("/readings", "weather/Reading")
        means = await brain.subscriber("/mean", "weather/Reading")
        for celsius in (10.0, 20.0, 30.0):
            await readings.publish({"station": "roof", "celsius": celsius})
            mean = await means.get(timeout=10)
            print(f"mean at {mean['station']}: {mean['celsius']:.1f}")


asyncio.run(main())
