"""A robot that has nothing asks the repository how to serve a drink, and does it in a simulated apartment.

Run it beside `rce up --dev`:

    python docs/examples/serve_drink.py [URL]

It needs the extra `mapping`. Another robot has been in the apartment before: it stores its map, and the recipe.
The robot of this program gets both, finds out where it is, has its ways planned, and drives them. Only the
localiser knows its pose.
"""

import asyncio
import math
import sys
import tempfile
from pathlib import Path

from rce.api.knowledge import NewEntry
from rce.client import Environment, Robot
from rce.client.knowledge import KnowledgeClient
from rce.errors import AlreadyExists
from rce.mapping.evaluation.simulation import simulate
from rce.mapping.evaluation.simulation.floor_plan import apartment
from rce.mapping.evaluation.simulation.live import LiveRobot
from rce.mapping.files.maps import read_map
from rce.mapping.files.outputs import write_map
from rce.mapping.geometry import Pose, wrap_angle
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.publication import map_cdr
from rce.mapping.robot import nanoseconds, odometry_cdr, scan_cdr
from rce.protocol.messages import Qos

URL = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:9000/"
USER = "testUser"
LATCHED = Qos(reliability="reliable", durability="transient_local", depth=1)
DEEP = Qos(reliability="reliable", depth=32)
DRINK, TABLE = (4.2, 2.4), (9.0, 9.2)  # metres, frame of the building
START = Pose(1.4, 7.2, 1.0)  # nobody tells the robot
SPEED, TURN_RATE, AHEAD, CLOSE = 0.8, 1.5, 0.5, 0.15  # metres and radians, a second and alone

RECIPE = """@prefix r: <http://example.org/recipe#> .
r:serveDrink a r:Recipe ; r:in "apartment.simulated" ; r:step r:fetch, r:bring .
r:fetch r:number 1 ; r:says "take the drink" ; r:x {0.x:.3f} ; r:y {0.y:.3f} .
r:bring r:number 2 ; r:says "put it on the table" ; r:x {1.x:.3f} ; r:y {1.y:.3f} .
"""
STEPS = """PREFIX r: <http://example.org/recipe#>
SELECT ?number ?says ?x ?y ?environment {{ GRAPH <https://rce.invalid/knowledge/recipe/{uid}> {{
    ?recipe r:in ?environment ; r:step ?step . ?step r:number ?number ; r:says ?says ; r:x ?x ; r:y ?y }} }}
ORDER BY ?number"""


def teach(knowledge: KnowledgeClient) -> None:
    """Store what another robot has learnt: a map of the apartment, and how to serve a drink in it."""
    recording, mapper = simulate(), GraphMapper()
    for scan in recording:
        mapper.add(scan)
    begin = Pose(*recording.truth[0, 1:].tolist())  # the map begins where that robot began
    places = [begin.to(Pose(*place, 0.0)) for place in (DRINK, TABLE)]
    try:
        knowledge.add(NewEntry("environment", "apartment", "simulated", public=True))
        with tempfile.TemporaryDirectory() as directory:
            write_map(Path(directory) / "map", mapper.grid())
            for name in ("map.yaml", "map.pgm"):
                knowledge.put_file("environment", "apartment.simulated", Path(directory) / name)
        knowledge.add(NewEntry("recipe", "serve_drink", "apartment", RECIPE.format(*places), public=True))
    except AlreadyExists:
        print("the repository has the recipe already")


class Butler:
    """Robot that drives by what the nodes of its environment say."""

    def __init__(self, brain: Environment) -> None:
        self.brain, self.body = brain, LiveRobot(apartment(), START)
        self.pose: Pose | None = None

    async def wake(self, knowledge: KnowledgeClient, environment: str) -> None:
        """Start the nodes, give them the map of the repository, and find out where the robot is."""
        await self.brain.add_node("localiser", "rce_localisation", "localiser")
        await self.brain.add_node("planner", "rce_planning", "planner")
        self.scans = await self.brain.publisher("/scan", "sensor_msgs/LaserScan", qos=DEEP, raw=True)
        self.odometry = await self.brain.publisher("/odom", "nav_msgs/Odometry", qos=DEEP, raw=True)
        self.poses = await self.brain.subscriber("/amcl_pose", "geometry_msgs/PoseWithCovarianceStamped", qos=LATCHED)
        self.planner = await self.brain.action_client("/compute_path_to_pose", "nav2_msgs/ComputePathToPose")
        costmaps = await self.brain.subscriber("/global_costmap/costmap", "nav_msgs/OccupancyGrid", qos=LATCHED)
        self.maps = await self.brain.publisher("/map", "nav_msgs/OccupancyGrid", qos=LATCHED, raw=True)
        with tempfile.TemporaryDirectory() as directory:
            for name in ("map.yaml", "map.pgm"):
                await asyncio.to_thread(knowledge.fetch_file, "environment", environment, name, Path(directory) / name)
            await self.maps.publish(map_cdr(read_map(Path(directory) / "map.yaml"), 1))
        await costmaps.get(timeout=120)
        for _ in range(500):
            if await self.step(0.0, 0.5):
                return
        raise SystemExit("the robot does not find out where it is")

    async def step(self, speed: float, turn_rate: float) -> Pose | None:
        """Drive for a tenth of a second; return the pose by the localiser, if it knows it."""
        scan = self.body.step(speed, turn_rate)
        stamp = nanoseconds(scan.stamp)
        await self.odometry.publish(odometry_cdr(stamp, scan.odometry))
        await self.scans.publish(scan_cdr(stamp, scan))
        try:
            async with asyncio.timeout(30 if self.pose else 0.3):
                async for message in self.poses:
                    sent = message["header"]["stamp"]
                    if self.pose is None or sent["sec"] * 10**9 + sent["nanosec"] >= stamp:
                        where, turned = message["pose"]["pose"]["position"], message["pose"]["pose"]["orientation"]
                        self.pose = Pose(where["x"], where["y"], 2 * math.atan2(turned["z"], turned["w"]))
                        return self.pose
        except TimeoutError:
            self.pose = None
        return None

    async def go(self, x: float, y: float) -> None:
        """Have a path planned to a place of the map, and follow it."""
        assert self.pose is not None
        sent = await self.planner.send_goal(
            {"start": stamped(*self.pose[:2]), "goal": stamped(x, y), "use_start": True}, timeout=60
        )
        status, result = await sent.result(60)
        if status != "succeeded":
            raise SystemExit(f"no path to {x:.1f}, {y:.1f}: {result['error_msg']}")
        path = [(each["pose"]["position"]["x"], each["pose"]["position"]["y"]) for each in result["path"]["poses"]]
        while (pose := self.pose) and math.dist(pose[:2], path[-1]) > CLOSE:
            nearest = min(range(len(path)), key=lambda i: math.dist(path[i], pose[:2]))
            target = next((each for each in path[nearest:] if math.dist(each, pose[:2]) > AHEAD), path[-1])
            error = wrap_angle(math.atan2(target[1] - pose.y, target[0] - pose.x) - pose.theta)
            turn = max(-TURN_RATE, min(TURN_RATE, 3 * error))
            await self.step(SPEED * max(math.cos(error), 0.0) ** 2, turn)
        if self.pose is None:
            raise SystemExit("the robot lost its way")


def stamped(x: float, y: float) -> dict:
    return {"header": {"frame_id": "map"}, "pose": {"position": {"x": x, "y": y}, "orientation": {"w": 1.0}}}


async def main() -> None:
    knowledge = KnowledgeClient(URL, user=USER, password=USER)
    await asyncio.to_thread(teach, knowledge)

    (recipe, *_) = knowledge.search(kind="recipe", prefix="serve_drink")
    rows = knowledge.query(STEPS.format(uid=recipe.uid)).rows
    steps = [[value.split('"')[1] for value in row] for row in rows]  # literals, written as in N-Triples
    print(f"recipe {recipe.uid}: {', then '.join(says for _, says, *_ in steps)}")

    async with Robot(URL, user=USER, robot="butler", password=USER) as robot, robot.environment("brain") as brain:
        butler = Butler(brain)
        await butler.wake(knowledge, environment=steps[0][4])
        print("the robot knows where it is")
        for (_, says, x, y, _), place in zip(steps, (DRINK, TABLE), strict=True):
            await butler.go(float(x), float(y))
            print(f"{says}: {math.dist(butler.body.pose[:2], place):.2f} m from the place")


asyncio.run(main())
