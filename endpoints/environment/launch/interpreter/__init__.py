"""Interpreter of launch files in Python, XML and YAML, which offers the modules `launch` and `launch_ros` itself.

The ROS 2 wheels lack these modules. A launch file only describes nodes here: nothing is started, and an action that
describes no node is refused with its name and line. Needs Python and PyYAML alone.
"""
