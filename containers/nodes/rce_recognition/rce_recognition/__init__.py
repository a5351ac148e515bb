"""Parts of the node `recogniser`. Only this package, its neighbours and the Environment endpoint import `rclpy`.

Recognition itself is in `rce.recognition`; parts that nodes share are in the package `rce_mapping` beside this one.
"""
