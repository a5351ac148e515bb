"""Parts of the node `planner`. Only this package, its neighbours and the Environment endpoint import `rclpy`.

The planners are in `rce.planning`; parts that nodes with maps share are in the package `rce_mapping` beside this one.
"""
