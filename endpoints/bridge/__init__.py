"""`rce bridge`: the client of the platform on a robot that runs ROS 2 itself (the Cloud IF node of RoboWS).

It forwards the configured topics, services, actions and transforms between the robot's ROS 2 and an environment, so
that the robot's nodes do not have to know the platform. It uses the interfaces of `endpoints.environment` and the
client library `rce.client`; nothing in the server processes depends on this package.
"""
