"""The client without asyncio: a plain program in which each call blocks.

Run it beside `rce up --dev`:

    python docs/examples/blocking.py [URL]
"""

import sys

from rce.client import BlockingRobot

URL = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:9000/"

with (
    BlockingRobot(URL, user="testUser", robot="plain", password="testUser") as robot,
    robot.environment("blocking_example") as brain,
):
    brain.add_node("echo", "rce_demo", "echo")
    say = brain.publisher("/say", "std_msgs/String")
    heard = brain.subscriber("/heard", "std_msgs/String")
    say.publish({"data": "hello without asyncio"})
    for message in heard:
        print(message["data"])
        break
