"""The environment of a guest, and the robots beside it, as the guest may see them."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from urllib.parse import unquote

from converters.definition import Definition
from endpoints.gateways import robots
from endpoints.gateways.changes import Changes
from endpoints.gateways.graphs import FRESH, Graphs
from endpoints.robot.endpoint import RobotEndpoint
from rce.control.calls.robots import ReadAssetFor, ReadRobotsFor, RobotInterfaceName, Sort
from rce.control.calls.watching import RosGraph
from rce.errors import InvalidRequest, RceError


class View:
    """What a guest sees.

    Args:
        endpoint: The Robot endpoint.
        graphs: Graphs of environments.
        environment: Tag of the environment.
        changes: What the guest has begun to change.

    Attributes:
        name: Name of the guest, which it has from its login on.
    """

    name: str

    def __init__(self, endpoint: RobotEndpoint, graphs: Graphs, environment: str, changes: Changes) -> None:
        self._endpoint = endpoint
        self._graphs = graphs
        self._environment = environment
        self._changes = changes
        self._robots: tuple[float, list[RobotInterfaceName]] = (-math.inf, [])  # when they were read

    async def check(self) -> None:
        """Read the graph anew; raises RceError if the guest may not see the environment."""
        await self._graphs.check(self._endpoint.master, self.name, self._environment)

    async def graph(self, age: float = FRESH) -> RosGraph:
        """Return the ROS graph of the environment with the robots, after the client's earlier operations.

        Args:
            age: Seconds for which an earlier answer is good enough, unless this client has changed the graph.

        Raises:
            RceError: The environment cannot be asked.
        """
        await self._changes.settle()
        return await self.present_graph(age)

    async def present_graph(self, age: float = FRESH) -> RosGraph:
        """Return the graph without waiting for operations; see `graph`."""
        since = max(time.monotonic() - age, self._changes.last)
        graph = await self._graphs.read(self._endpoint.master, self.name, self._environment, since)
        return robots.with_robots(graph, await self._robot_interfaces(since))

    async def _robot_interfaces(self, since: float) -> list[RobotInterfaceName]:
        if self._robots[0] < since:
            now = time.monotonic()
            found = await self._endpoint.master.call(ReadRobotsFor(self.name))
            self._robots = now, found.interfaces
        return self._robots[1]

    async def robot_interface(self, address: str, kind: str) -> str:
        """Return the interface of a robot that an address means, or an empty string: it is the environment's."""
        found = robots.find(await self._robot_interfaces(time.monotonic() - FRESH), address, kind)
        if found:
            with suppress(RceError):  # the environment is away
                graph = await self._graphs.read(self._endpoint.master, self.name, self._environment)
                return "" if robots.has(graph, address) else found
        return found

    async def asset(self, uri: str) -> bytes:
        """Return a file of a package of the environment, `package://PACKAGE/PATH`.

        Raises:
            InvalidRequest: The URI has another form.
            RceError: There is no such file, or it cannot be read.
        """
        scheme, _, rest = uri.partition("://")
        package, _, path = rest.partition("/")
        if scheme != "package" or not package or not path:
            raise InvalidRequest(f"{uri[:200]}: only files of packages can be fetched, package://PACKAGE/PATH")
        data = bytearray()
        while True:
            call = ReadAssetFor(self.name, self._environment, package, unquote(path), len(data))
            piece = await self._endpoint.master.call(call)
            data += piece.data
            if len(data) >= piece.size or not piece.data:
                return bytes(data)

    async def definitions(self, type: str, sort: Sort) -> dict[str, Definition]:
        """Return the definition of a type, its parts and the types in it, by name; raises UnknownType."""
        return await self._endpoint.definitions(self.name.partition("/")[0], type, sort)
