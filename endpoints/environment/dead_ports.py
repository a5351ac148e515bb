"""Ports in shared memory whose reader was killed.

A participant of Fast DDS receives through a port, a ring buffer in /dev/shm, which it locks. Senders keep the ports
open to which they have written. A new participant takes the first port that nobody locks. If that is the port of one
that was killed, the new one gets nothing until Fast DDS notices that the old reader does not read (after 1 s), and
until the senders repeat what was lost (after up to 3 s more).
"""

from __future__ import annotations

import fcntl
import os
import re
from contextlib import ExitStack
from itertools import islice
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")
LOCK = re.compile(r"fastdds_port\d+_el")
MOST = 100  # ports that are locked; nodes can make any number of files


def lock_dead_ports(directory: Path = SHARED_MEMORY) -> ExitStack:
    """Lock all ports that nobody reads, so that new participants take others until the result is closed."""
    locks = ExitStack()
    found = (path for path in directory.iterdir() if LOCK.fullmatch(path.name))
    for path in islice(found, MOST):
        try:
            lock = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        except OSError:  # its reader has ended meanwhile, or it is another user's
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:  # it has a reader
            os.close(lock)
        else:
            locks.callback(os.close, lock)
    return locks
