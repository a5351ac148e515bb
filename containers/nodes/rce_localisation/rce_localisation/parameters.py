"""Parameters of the localiser node: those of AMCL that have a meaning here, and those of odometry of `rce_mapping`."""

from __future__ import annotations

from rce_mapping.parameters import declare_fixed, declare_number, flag, number
from rclpy.node import Node

from rce.mapping.geometry import Pose

FAR = 1e6  # metres
NUMBERS = {  # default, lowest and highest value, description
    "laser_max_range": (30.0, -1.0, FAR, "Longest beams that are used, metres; -1: all that the laser measures."),
    "laser_min_range": (-1.0, -1.0, FAR, "Shortest beams that are used, metres; -1: all."),
    "update_min_d": (0.0, 0.0, FAR, "Metres by odometry after which a scan is used; scans between are not."),
    "update_min_a": (0.0, 0.0, 7.0, "Radians by odometry after which a scan is used."),
    "transform_tolerance": (1.0, 0.0, 60.0, "Seconds by which the transform is dated after its scan."),
    "initial_pose.x": (0.0, -FAR, FAR, "Initial pose, metres."),
    "initial_pose.y": (0.0, -FAR, FAR, "Initial pose, metres."),
    "initial_pose.z": (0.0, -FAR, FAR, "Not used: the map is plane."),
    "initial_pose.yaw": (0.0, -7.0, 7.0, "Initial pose, radians."),
    "odom_timeout": (0.5, 0.0, 60.0, "Wall time that a scan waits for the odometry of its stamp, seconds."),
}
TEXTS = {
    "global_frame_id": ("map", "Frame of the map."),
    "odom_frame_id": ("odom", "Frame of the odometry."),
    "base_frame_id": ("base_link", "Frame of the robot."),
    "scan_topic": ("scan", "Topic of the scans."),
    "map_topic": ("map", "Topic of the map."),
}
FLAGS = {
    "set_initial_pose": (False, "Begin at initial_pose; otherwise the robot is searched in the whole map."),
    "always_reset_initial_pose": (False, "Begin at initial_pose again with each new map, not at the last pose."),
    "first_map_only": (False, "Ignore all maps but the first."),
    "tf_broadcast": (True, "Publish the transform of the odometry frame, or of the robot without odometry."),
    "use_odometry": (True, "Use odometry if there is any."),
    "odometry_from_tf": (False, "Use the odometry in /tf instead of the topic odom."),
}
OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


def declare(node: Node) -> None:
    """Declare all parameters, all read-only, and warn of those that were given and are none of them.

    The node must declare automatically what was given, since ROS names no other way to learn of it.
    """
    known = NUMBERS | TEXTS | FLAGS
    given = list(node.get_parameters_by_prefix(""))
    for name in known.keys() & set(given):
        node.undeclare_parameter(name)
    unknown = sorted(name for name in given if name not in known and not name.startswith(OF_ROS))
    if unknown:
        node.get_logger().warning(f"parameters that have no meaning here: {', '.join(unknown)}")
    for name, (default, low, high, description) in NUMBERS.items():
        declare_number(node, name, default, (low, high), description)
    for name, (value, description) in (TEXTS | FLAGS).items():
        declare_fixed(node, name, value, description)


def initial_pose(node: Node) -> Pose | None:
    """Return the initial pose; None if the robot may be anywhere."""
    if not flag(node, "set_initial_pose"):
        return None
    return Pose(*(number(node, f"initial_pose.{name}") for name in ("x", "y", "yaw")))
