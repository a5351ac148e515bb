"""Parts of the node `re_comm`. Only this package, its neighbours and the Environment endpoint import `rclpy`.

The client of the platform is in `rce.client.environment_knowledge`.
"""
