"""A robot that carries out goals of another one as a ROS 2 action: feedback, a result, and a canceled goal.

Run it beside `rce up --dev`; it needs no ROS 2:

    python docs/examples/action.py [URL]

The worker makes a Fibonacci number every 0.2 s. The client waits for the result of the first goal, and cancels the
second one. A node of an environment may be either side instead: see docs/actions.md.
"""

import asyncio
import sys

from rce.client import Robot, ServerGoal

URL = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:9000/"
FIBONACCI = "example_interfaces/Fibonacci"


async def count(goal: ServerGoal) -> dict[str, list[int]]:
    sequence = [0, 1]
    try:
        while len(sequence) < goal.request["order"]:
            await asyncio.sleep(0.2)
            sequence.append(sequence[-2] + sequence[-1])
            goal.publish_feedback({"sequence": sequence})
    except asyncio.CancelledError:
        print("the worker stops")
    return {"sequence": sequence}


async def main() -> None:
    async with (
        Robot(URL, user="testUser", robot="worker", password="testUser") as worker,
        Robot(URL, user="testUser", robot="client", password="testUser") as robot,
    ):
        await worker.action_server("count", FIBONACCI, count, accept=lambda request: request["order"] <= 1000)
        client = await robot.action_client("count", FIBONACCI, to="worker/count")

        goal = await client.send_goal({"order": 6})
        async for feedback in goal:
            print(f"so far: {list(feedback['sequence'])}")
        result = await goal.result()
        print(f"{result.status}: {list(result.value['sequence'])}")

        goal = await client.send_goal({"order": 1000})
        await goal.cancel()
        print((await goal.result()).status)


asyncio.run(main())
