"""Resources of one slot of a machine. An environment of size n gets n times these unless it requests other amounts."""

from __future__ import annotations

MB = 1024 * 1024

CORES = 1.0
MEMORY = 1024 * MB  # bytes
PIDS = 512  # processes and threads
LEAST_PIDS = 32  # of an environment of any size: it has 17 threads without nodes
