"""Parts of the node `localiser`. Only this package, its neighbours and the Environment endpoint import `rclpy`.

The localiser is in `rce.mapping`; parts that nodes with maps share are in the package `rce_mapping` beside this one.
"""
