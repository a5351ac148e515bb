"""Mapping of recordings by several workers, which need not be on one machine.

A job is cut into units of work (`units`). A worker executes units, one at a time, and keeps what it has seen of the
maps (`worker`). The job asks for units and puts the answers together (`job`); the crew hands units to workers and gives
the unit of a worker that dies to another one (`crew`). Workers are nodes in environments of their own (`environments`).
"""
