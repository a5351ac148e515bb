"""`rce bridge`: the part of the platform on a robot that runs ROS 2 itself. It carries chosen topics, services and
transforms to an environment and back (the Cloud IF node of RoboWS), so that the robot's nodes need to know nothing of
the platform.
"""
