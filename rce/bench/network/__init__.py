"""Robots on bad networks: what arrives, how old it is, and how fast a connection recovers.

- `line`: a line with delay, jitter, loss, a rate, a queue and outages, and named profiles.
- `emulator`: the program that passes packets between two TUN devices over such a line; needs root.
- `lab`: a network namespace for a robot, whose only way to this machine is an emulated line.
- `streams`, `robot`: what a robot sends and receives, with the client library or as plain JSON, as a program.
- `run`, `report`: a run over each profile, and its result.
"""
