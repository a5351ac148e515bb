"""Users' own ROS packages: the files of a package, its archive format, and the client that pushes and lists packages.

Shared by the command line, the Master's depot and the task sets. Storage belongs to `master.storage`, unpacking for
environments to `containers.packages`.
"""
