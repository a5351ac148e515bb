"""ROS 2 node `team`: builds one map from the scans of several robots.

The parameter `robots` lists their names. Each robot has its own topics under its name: it publishes `NAME/scan` and
`NAME/odom`; the node publishes `NAME/pose` (one for each scan, as the node `mapper`), `NAME/path` and `NAME/map`, and
serves `NAME/dynamic_map`. Robots whose maps are joined share one map and one frame; `NAME/team` lists them.
"""

from __future__ import annotations

import json
from functools import partial

from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetMap
from rclpy.node import Node
from std_msgs.msg import String

from rce.errors import InvalidRequest
from rce.mapping.pose_graph.team_mapper import TeamMapper

from . import messages
from .map_output import LATCHED
from .parameters import INTERVAL, declare, number, settings_of, text, texts
from .track import Track

MAPPERS = ["graph"]  # mappers whose maps can be joined


class TeamNode(Node):
    """Node around a `TeamMapper`.

    Attributes:
        team: The mapper.
    """

    def __init__(self) -> None:
        """Declare the parameters and start an empty map for each robot.

        Raises:
            InvalidRequest: The parameter `robots` is empty.
        """
        super().__init__("team")
        declare(self, MAPPERS)
        names = texts(self, "robots", "Names of the robots of the team.")
        if not names:
            raise InvalidRequest(
                "the parameter robots is empty: list the names of the robots of the team", field="robots"
            )
        self.team = TeamMapper(names, settings_of(self))
        self._frame = text(self, "map_frame")
        self._members = {name: _Member(self, name) for name in names}
        self.create_timer(number(self, INTERVAL), self._publish)
        self._publish()

    def _publish(self) -> None:
        for member in self._members.values():
            member.publish()


class _Member:
    """Topics and services of one robot of the team."""

    def __init__(self, node: TeamNode, name: str) -> None:
        self._node, self._name = node, name
        self._track = Track(node, partial(node.team.add, name), f"{name}/")
        self._map_out = node.create_publisher(OccupancyGrid, f"{name}/map", LATCHED)
        self._team_out = node.create_publisher(String, f"{name}/team", LATCHED)
        self._published: tuple[int, list[str]] = -1, []
        node.create_service(GetMap, f"{name}/dynamic_map", self._on_get_map)

    def publish(self) -> None:
        """Publish map, path and team if the team has new scans or new members."""
        team = self._node.team.team(self._name)
        current = sum(len(self._node._members[each]._track.stamps) for each in team), team
        if current != self._published:
            self._publish_map()
            self._published = current

    def _publish_map(self) -> OccupancyGrid:
        node = self._node
        stamps = self._track.stamps
        stamp = stamps[-1] if stamps else node.get_clock().now().to_msg()
        self._track.publish_path(node.team.trajectory(self._name))
        message = messages.grid_message(node.team.grid(self._name), stamp, node._frame)
        self._map_out.publish(message)
        self._team_out.publish(String(data=json.dumps(node.team.team(self._name))))
        return message

    def _on_get_map(self, _request: GetMap.Request, response: GetMap.Response) -> GetMap.Response:
        self._node.team.settle()
        response.map = self._publish_map()
        return response
