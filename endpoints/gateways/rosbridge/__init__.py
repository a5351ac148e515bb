"""rosbridge v2: the operations of https://github.com/RobotWebTools/rosbridge_suite, and the services of rosapi."""
