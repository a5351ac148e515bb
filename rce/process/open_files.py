"""The limit of open files of a process."""

from __future__ import annotations

import resource

MOST = 65_536  # as of the services that `provision install` sets up


def raise_limit() -> None:
    """Allow `MOST` open files, or as many as the system lets this process have; what it starts inherits the limit.

    A robot is a socket, and a subscription two descriptors. Shells usually start programs with a limit of 1,024.
    """
    allowed, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(allowed, min(most, MOST)), most))
