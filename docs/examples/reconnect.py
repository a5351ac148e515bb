"""Keep going while the connection breaks: the client reconnects by itself and reports it as events.

Run it beside `rce up --dev`, and end the Robot endpoint meanwhile; `rce up` starts it again:

    python docs/examples/reconnect.py [URL]
    pkill -f "endpoints.robot.*$HOME/.local/share/rce/robot"    # in another terminal

The pattern matches only the platform whose data are in the default directory, not others on this machine. With
`--data-dir`, put that directory in its place.

The program counts, and waits in `publish` while there is no connection. It ends 20 messages after a reconnection.
"""

import asyncio
import sys

from rce.client import Disconnected, Reconnected, Robot

URL = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:9000/"


async def report(robot: Robot, reconnected: asyncio.Event) -> None:
    async for event in robot.events():
        if isinstance(event, Disconnected):
            print("disconnected:", event.reason, flush=True)
        elif isinstance(event, Reconnected):
            print("reconnected,", "same session" if event.resumed else "new session", flush=True)
            reconnected.set()


async def main() -> None:
    async with Robot(URL, user="testUser", robot="counter", password="testUser") as robot:
        reconnected = asyncio.Event()
        reporter = asyncio.create_task(report(robot, reconnected))
        async with robot.environment("reconnect_example") as brain:
            counts = await brain.publisher("/count", "std_msgs/Int32")
            number, remaining = 0, 20
            while remaining:
                number += 1
                await counts.publish({"data": number}, timeout=60)
                print("published", number, flush=True)
                remaining -= reconnected.is_set()
                await asyncio.sleep(0.1)
        reporter.cancel()


asyncio.run(main())
