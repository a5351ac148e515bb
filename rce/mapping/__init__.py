"""Mapping with a 2D laser: recordings, scan matching, occupancy grids, their files and a simulated robot.

Pure: no ROS, no network. Needs the extra `mapping` (NumPy, Numba, OpenCV, rosbags). Units are metres, radians, seconds;
x points forward, y to the left, angles turn counter-clockwise.
"""
