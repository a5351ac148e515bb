"""Several robots that build one map together, as a ROS 2 node.

The parameter `robots` names them. Each has topics of its own under its name: `NAME/scan` and `NAME/odom` in,
`NAME/pose` (one for each scan, as that of the node `mapper`), `NAME/path` and `NAME/map` out, and the service
`NAME/dynamic_map`. Maps, poses and paths of robots whose maps are joined are in one frame and show one map;
`NAME/team` says with whom.
"""

from __future__ import annotations

import json
from functools import partial

from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetMap
from rclpy.node import Node
from std_msgs.msg import String

from rce.errors import InvalidRequest
from rce.mapping.team import TeamMapper

from . import messages
from .map_output import LATCHED
from .parameters import INTERVAL, declare, number, settings_of, text, texts
from .track import Track

MAPPER = ["graph"]  # the one whose maps can be joined


class TeamNode(Node):
    """Feeds a team's mapper and publishes what it says to each robot."""

    def __init__(self) -> None:
        super().__init__("team")
        declare(self, MAPPER)
        names = texts(self, "robots", "Names of the robots of the team.")
        if not names:
            raise InvalidRequest("the parameter robots is empty: name the robots of the team", field="robots")
        self.team = TeamMapper(names, settings_of(self))
        self._frame = text(self, "map_frame")
        self._members = {name: _Member(self, name) for name in names}
        self.create_timer(number(self, INTERVAL), self._publish)
        self._publish()

    def _publish(self) -> None:
        for member in self._members.values():
            member.publish()


class _Member:
    """One robot of the team."""

    def __init__(self, node: TeamNode, name: str) -> None:
        self._node, self._name = node, name
        self._track = Track(node, partial(node.team.add, name), f"{name}/")
        self._map_out = node.create_publisher(OccupancyGrid, f"{name}/map", LATCHED)
        self._team_out = node.create_publisher(String, f"{name}/team", LATCHED)
        self._published: tuple[int, list[str]] = -1, []
        node.create_service(GetMap, f"{name}/dynamic_map", self._on_get_map)

    def publish(self) -> None:
        """Map, path and team, if there is anything new in the team."""
        team = self._node.team.team(self._name)
        news = sum(len(self._node._members[each]._track.stamps) for each in team), team
        if news != self._published:
            self._publish_map()
            self._published = news

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
