#!/usr/bin/env python3
"""The MPI program: each rank sends its number around, all sum them up; rank 0 prints the sum and where they ran."""

from __future__ import annotations

import socket

from mpi4py import MPI

if __name__ == "__main__":
    world = MPI.COMM_WORLD
    total = world.allreduce(world.rank + 1)
    hosts = world.gather(socket.gethostname())
    if world.rank == 0:
        print(f"sum {total} of {world.size} ranks on {' '.join(hosts)}", flush=True)
