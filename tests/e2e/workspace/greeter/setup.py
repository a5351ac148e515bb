"""As `ros2 pkg create --build-type ament_python` makes it."""

from setuptools import setup

setup(
    name="greeter",
    version="0.1.0",
    packages=["greeter"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/greeter"]),
        ("share/greeter", ["package.xml"]),
    ],
    entry_points={"console_scripts": ["greet = greeter.node:main"]},
)
