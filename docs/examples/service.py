"""Call a service of a node, and offer a service to the nodes of the environment.

Run it beside `rce up --dev`:

    python docs/examples/service.py [URL]

Every ROS 2 node offers services for its parameters; this robot asks the node `echo` for their names. Then it offers
the service /light, and calls it through the ROS 2 graph of the environment, as a node would.
"""

import asyncio
import sys
from typing import Any

from rce.client import Robot

URL = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:9000/"


def switch(request: dict[str, Any]) -> dict[str, Any]:
    """Answer a request for the service /light."""
    return {"success": True, "message": "light on" if request["data"] else "light off"}


async def main() -> None:
    async with (
        Robot(URL, user="testUser", robot="lamp", password="testUser") as robot,
        robot.environment("service_example") as brain,
    ):
        await brain.add_node("echo", "rce_demo", "echo")
        parameters = await brain.service_client("/echo/list_parameters", "rcl_interfaces/ListParameters")
        response = await parameters.call({})
        print("parameters of the node:", response["result"]["names"])

        await brain.service_provider("/light", "std_srvs/SetBool", switch)
        light = await brain.service_client("/light", "std_srvs/SetBool")
        print((await light.call({"data": True}))["message"])


asyncio.run(main())
