"""The Container task set, which starts and stops environments through an engine.

Engines are packages of their own (`process`, `docker`, `swarm`); modules here serve the task set or several engines.
Programs that run inside environments belong in `endpoints` and `containers.nodes`.
"""
