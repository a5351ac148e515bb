"""What a slot of a machine stands for: an environment of `size` n has n times this unless it asks for other figures."""

from __future__ import annotations

MB = 1024 * 1024

CORES = 1.0
MEMORY = 1024 * MB  # bytes
PIDS = 512  # processes and threads
