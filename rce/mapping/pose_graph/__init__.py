"""Mapper `graph`: pose-graph SLAM with loop closing, for one robot and for teams of robots.

- `graph`, `optimisation`: the pose graph and its least-squares solution.
- `loops`: recognising places that the robot has visited before.
- `trail`: nodes along the way of a robot, and the scans that are kept at them.
- `mapper`: the mapper of one robot.
- `overlaps`: finding a place of one robot in the whole map of another.
- `team_graph`, `team_mapper`: the common graph of joined robots, and the mapper of a team.
"""
