"""Launch files: nodes of an environment that are described, started and ended together.

`interpreter` is the program that carries out a launch file, in a process of its own as it is user code; it yields a
list of nodes. `evaluation` starts it, `group` runs the nodes.
"""
