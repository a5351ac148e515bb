"""Installation of RCE: the script `provision` and its commands, images of environments, and type support for ROS 2.

The modules of the script run on the standard library alone, before anything is installed. Only those for images and for
type support import `rce` and other packages. What runs on the platform does not belong here.
"""
