from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    how = LaunchConfiguration("how")
    return LaunchDescription(
        [
            DeclareLaunchArgument("how", default_value="live"),
            LogInfo(msg=["it is ", how]),
            Node(package="probe", executable="say", name="one", arguments=[how]),
            Node(package="probe", executable="say", name="two", namespace="deep", arguments=["live"]),
        ]
    )
