"""Parameters of the nodes, with the descriptions that `ros2 param describe` shows."""

from __future__ import annotations

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from rce.mapping.mapper import MapperSettings

INTERVAL, UPDATES, MAPPER = "map_update_interval", "map_updates_interval", "mapper"


def declare(node: Node, mappers: list[str]) -> None:
    """Declare all parameters. All but the two intervals are read-only; the first mapper is the default."""
    declare_fixed(node, MAPPER, mappers[0], f"Mapper: {', '.join(mappers)}.")
    declare_number(node, "resolution", 0.05, (0.01, 0.5), "Size of a cell of the map, metres.")
    declare_number(node, "max_range", 30.0, (1.0, 200.0), "Maximum length of the beams that are used, metres.")
    _count(
        node,
        "particles",
        30,
        (1, 1000),
        "Number of particles of the mapper particle. More close larger loops and take longer.",
    )
    _count(
        node,
        "seed",
        0,
        (0, 2**31 - 1),
        "Seed of the random numbers of the mapper particle. The same seed gives the same map.",
    )
    declare_number(
        node, INTERVAL, 5.0, (0.1, 3600.0), "Wall time between publications of map and path, seconds.", fixed=False
    )
    declare_number(
        node, UPDATES, 1.0, (0.0, 3600.0), "Wall time between messages of map_updates, seconds; 0: none.", fixed=False
    )
    declare_number(
        node, "odom_timeout", 0.5, (0.0, 60.0), "Wall time that a scan waits for the odometry of its stamp, seconds."
    )
    declare_fixed(node, "use_odometry", True, "Use odometry if there is any.")
    declare_fixed(node, "odometry_from_tf", False, "Use the odometry in /tf instead of the topic odom.")
    declare_fixed(node, "map_frame", "map", "Frame of the map, the poses and the path.")
    declare_fixed(node, "odom_frame", "odom", "Frame of the odometry in /tf.")
    declare_fixed(node, "base_frame", "base_link", "Frame of the robot.")


def declare_number(
    node: Node, name: str, default: float, bounds: tuple[float, float], description: str, fixed: bool = True
) -> None:
    """Declare a number; `fixed` makes it read-only."""
    low, high = bounds
    limits = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
    node.declare_parameter(
        name, default, ParameterDescriptor(description=description, floating_point_range=limits, read_only=fixed)
    )


def _count(node: Node, name: str, default: int, bounds: tuple[int, int], description: str) -> None:
    limits = [IntegerRange(from_value=bounds[0], to_value=bounds[1], step=1)]
    node.declare_parameter(
        name, default, ParameterDescriptor(description=description, integer_range=limits, read_only=True)
    )


def declare_fixed(node: Node, name: str, default: str | bool, description: str) -> None:
    """Declare a text or a flag, which is read-only."""
    node.declare_parameter(name, default, ParameterDescriptor(description=description, read_only=True))


def settings_of(node: Node) -> MapperSettings:
    """Return the settings of the mapper from the parameters."""
    return MapperSettings(
        resolution=number(node, "resolution"),
        max_range=number(node, "max_range"),
        particles=int(number(node, "particles")),
        seed=int(number(node, "seed")),
    )


def texts(node: Node, name: str, description: str) -> list[str]:
    """Declare a list of strings without a default; return its value, empty if it is not set."""
    kind = Parameter.Type.STRING_ARRAY
    node.declare_parameter(name, kind, ParameterDescriptor(description=description, read_only=True))
    return [str(each) for each in node.get_parameter_or(name, Parameter(name, kind, [])).value or []]


def number(node: Node, name: str) -> float:
    """Return the value of a number."""
    return float(node.get_parameter(name).value)


def flag(node: Node, name: str) -> bool:
    """Return the value of a boolean."""
    return bool(node.get_parameter(name).value)


def text(node: Node, name: str) -> str:
    """Return the value of a string."""
    return str(node.get_parameter(name).value)


def choice(node: Node, name: str, allowed: list[str]) -> str:
    """Return the value of a string that is one of `allowed`.

    Raises:
        ValueError: It is not.
    """
    value = text(node, name)
    if value not in allowed:
        raise ValueError(f"the parameter {name} is {value!r}; it must be one of: {', '.join(allowed)}")
    return value
