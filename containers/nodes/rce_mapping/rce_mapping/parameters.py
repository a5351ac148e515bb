"""The parameters of the node, with what `ros2 param describe` says of them."""

from __future__ import annotations

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from rce.mapping.mapper import MapperSettings

INTERVAL, UPDATES, MAPPER = "map_update_interval", "map_updates_interval", "mapper"


def declare(node: Node, mappers: list[str]) -> None:
    """Declare all parameters; all but the interval are fixed once the node runs. The first mapper is the default."""
    _text(node, MAPPER, mappers[0], f"How the map is made: {', '.join(mappers)}.")
    _number(node, "resolution", 0.05, (0.01, 0.5), "Size of a cell of the map, m.")
    _number(node, "max_range", 30.0, (1.0, 200.0), "Beams longer than this are not used, m.")
    _count(node, "particles", 30, (1, 1000), "Of the mapper particle: more close larger loops and take longer.")
    _count(node, "seed", 0, (0, 2**31 - 1), "Of the random numbers of the mapper particle; the same map for the same.")
    _number(node, INTERVAL, 5.0, (0.1, 3600.0), "Wall time between two publications of map and path, s.", fixed=False)
    _number(
        node, UPDATES, 1.0, (0.0, 3600.0), "Wall time between two messages of map_updates, s; 0: none.", fixed=False
    )
    _number(
        node, "odom_timeout", 0.5, (0.0, 60.0), "How long a scan waits for the odometry of its stamp, wall time, s."
    )
    node.declare_parameter(
        "use_odometry", True, ParameterDescriptor(description="Use odometry where there is any.", read_only=True)
    )
    node.declare_parameter(
        "odometry_from_tf",
        False,
        ParameterDescriptor(description="Take the odometry from tf instead of the topic odom.", read_only=True),
    )
    _text(node, "map_frame", "map", "Frame of the map, the poses and the path.")
    _text(node, "odom_frame", "odom", "Frame of the odometry, for tf.")
    _text(node, "base_frame", "base_link", "Frame of the robot.")


def _number(
    node: Node, name: str, default: float, bounds: tuple[float, float], description: str, fixed: bool = True
) -> None:
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


def _text(node: Node, name: str, default: str, description: str) -> None:
    node.declare_parameter(name, default, ParameterDescriptor(description=description, read_only=True))


def settings_of(node: Node) -> MapperSettings:
    return MapperSettings(
        resolution=number(node, "resolution"),
        max_range=number(node, "max_range"),
        particles=int(number(node, "particles")),
        seed=int(number(node, "seed")),
    )


def texts(node: Node, name: str, description: str) -> list[str]:
    """Declare a list of texts, which has no default; empty if it is not set."""
    kind = Parameter.Type.STRING_ARRAY
    node.declare_parameter(name, kind, ParameterDescriptor(description=description, read_only=True))
    return [str(each) for each in node.get_parameter_or(name, Parameter(name, kind, [])).value or []]


def number(node: Node, name: str) -> float:
    return float(node.get_parameter(name).value)


def flag(node: Node, name: str) -> bool:
    return bool(node.get_parameter(name).value)


def text(node: Node, name: str) -> str:
    return str(node.get_parameter(name).value)


def choice(node: Node, name: str, allowed: list[str]) -> str:
    """The text of a parameter. ValueError if it is not one of those allowed."""
    value = text(node, name)
    if value not in allowed:
        raise ValueError(f"the parameter {name} is {value!r}; it may be: {', '.join(allowed)}")
    return value
