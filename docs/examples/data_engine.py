"""Two robots and a database: one reports what it sees, the other asks where it was.

Run it beside `rce up --dev` and PostgreSQL, after the service has the address of the database and is published:

    rce login http://127.0.0.1:9000/ --user testUser
    echo "postgresql://user:password@10.0.0.5/robots" | rce secret set database
    rce service publish docs/examples/data_engine
    python docs/examples/data_engine.py [URL]

The nodes need psycopg: `pip install -e '.[postgresql]'` beside the platform, or with Docker an image that has it
(`rce image build`) and the egress policy `10.0.0.5:5432` (docs/catalogue.md).
"""

import asyncio
import json
import sys

from rce.client import Robot, Service

URL = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:9000/"


def robot(name: str) -> Robot:
    """Return a robot of the user for development."""
    return Robot(URL, user="testUser", robot=name, password="testUser")


async def ask(service: Service, label: str) -> dict[str, float]:
    """Ask until something with this label was seen."""
    queries, answers = service.publisher("queries"), service.subscriber("answers")
    while True:
        await queries.publish({"data": label})
        answer: dict[str, float] | None = json.loads((await answers.get())["data"])
        if answer is not None:
            return answer
        await asyncio.sleep(0.2)


async def main() -> None:
    """Report a cup with one robot, and ask for it with the other."""
    async with (
        robot("scout") as scout,
        robot("waiter") as waiter,
        await scout.service("data_engine") as eyes,
        await waiter.service("data_engine") as memory,
    ):
        await eyes.publisher("detections").publish({"data": json.dumps({"label": "cup", "x": 1.5, "y": -2.0})})
        found = await ask(memory, "cup")
        print(f"the cup is at {found['x']}, {found['y']}")


asyncio.run(main())
