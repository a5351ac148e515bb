"""A ROS package as `ros2 pkg create --build-type ament_python` makes it, with a launch file and a configuration."""

from __future__ import annotations

from pathlib import Path

SETUP = """
from glob import glob
from setuptools import find_packages, setup
package_name = "{name}"
setup(
    name=package_name, version="0.1.0", packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package_name]),
        ("share/" + package_name, ["package.xml"]),
        ("share/" + package_name + "/launch", glob("launch/*")),
        ("share/" + package_name + "/config", glob("config/*")),
    ],
    install_requires=["setuptools"], zip_safe=True,
    entry_points={{"console_scripts": ["talker = {target}"]}},
)
"""
NODE = """
from pathlib import Path

import rclpy
from ament_index_python.packages import get_package_share_directory
from std_msgs.msg import String


def main(args=None):
    rclpy.init(args=args)
    node = rclpy.create_node("talker")
    text = (Path(get_package_share_directory("{name}")) / "config" / "text.txt").read_text().strip()
    publisher = node.create_publisher(String, "chatter", 10)
    node.create_timer(0.2, lambda: publisher.publish(String(data=text)))
    print("talking:", text, flush=True)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
"""
FILES = {
    "package.xml": '<package format="3"><name>{name}</name><version>0.1.0</version><description>d</description>'
    '<maintainer email="a@b.c">a</maintainer><license>MIT</license><exec_depend>rclpy</exec_depend>'
    "<export><build_type>ament_python</build_type></export></package>",
    "setup.cfg": "[develop]\nscript_dir=$base/lib/{name}\n[install]\ninstall_scripts=$base/lib/{name}\n",
    "setup.py": SETUP,
    "resource/{name}": "",
    "{name}/__init__.py": "",
    "{name}/talker.py": NODE,
    "launch/talker.launch.py": "",
    "config/text.txt": "as colcon leaves it\n",
}


def make_ament_package(directory: Path, name: str = "talking", target: str = "") -> Path:
    """Write a package with the entry point `talker` and return its directory."""
    package = directory / name
    for path, content in FILES.items():
        file = package / path.format(name=name)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(content.format(name=name, target=target or f"{name}.talker:main"))
    return package
