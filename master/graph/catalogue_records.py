"""Records of the catalogue of services.

Offer 1─* Instance: a service, and the environments that run it
Instance 1─* Use: a robot takes part in an instance; Tally counts that by user
"""

from __future__ import annotations

from typing import Literal

from msgspec import Struct

from master.graph.records import EnvironmentOptions, NodeRestart, ParameterValue, Qos


class Port(Struct, frozen=True, omit_defaults=True):
    """A point at which a service exchanges data with a robot.

    `takes`: topic from the robot; `gives`: topic to it; `service`, `action`: requests or goals of the robot. A relative
    `address` is in the namespace of the robot if the instance is shared, an absolute one the same for all robots.
    """

    name: str
    kind: Literal["takes", "gives", "service", "action"]
    type: str
    address: str
    qos: Qos = Qos()


class OfferedNode(Struct, frozen=True, omit_defaults=True):
    """A node of a service: one in each instance, or `per_robot` one for each robot."""

    tag: str
    package: str
    executable: str
    arguments: str = ""
    name: str = ""
    namespace: str = ""
    restart: NodeRestart = ""
    per_robot: bool = False
    parameters: dict[str, ParameterValue] = {}


class Offer(Struct, frozen=True):
    """A service in the catalogue; `revision` changes whenever it is published.

    An instance serves `robots` robots; with more than one it is shared, and there are from `least` to `most` instances.
    One that has been empty for `idle` seconds is stopped. `packages` are digests. `shared` lists who may use it.
    """

    name: str  # user/name
    revision: str
    description: str
    ports: list[Port]
    nodes: list[OfferedNode]
    parameters: dict[str, ParameterValue]
    options: EnvironmentOptions
    packages: list[str]
    robots: int
    least: int
    most: int
    most_per_user: int  # robots of one user; 0 is no limit
    idle: float
    shared: list[str]

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return self.name

    @property
    def is_shared(self) -> bool:
        """Return whether an instance serves several robots, also of several users."""
        return self.robots > 1


class Instance(Struct, frozen=True):
    """Mark of an environment that runs a service, in the revision with which it was started."""

    environment: str
    offer: str
    revision: str

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return self.environment


class Use(Struct, frozen=True):
    """A robot that takes part in an instance, under a tag of its own; its items are removed with it.

    `interfaces` has the keys of its interfaces, each in the instance before that at the robot, and `nodes` those of its
    nodes in the instance.
    """

    robot: str
    tag: str
    offer: str
    environment: str
    interfaces: list[str] = []
    nodes: list[str] = []

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return f"{self.robot}/{self.tag}"


class Tally(Struct, frozen=True):
    """Number of times that robots of a user began to use a service."""

    offer: str
    user: str
    uses: int

    @property
    def key(self) -> str:
        """Return the key of the record in its table."""
        return f"{self.offer} {self.user}"
