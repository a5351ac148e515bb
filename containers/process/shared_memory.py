"""Clean-up of shared memory that Fast DDS leaves behind when a participant is killed.

A participant holds an exclusive lock on `fastdds_<16 hex>_el` while it runs; its segment `fastdds_<16 hex>` may have
hundreds of megabytes. This does what `fastdds shm clean` does for the whole host, whenever an environment is removed.
"""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")
LOCK = re.compile(r"(fastdds_[0-9a-f]{16})_el")
PORT = re.compile(r"(?:sem\.)?fastdds_port(\d+)(?:_el|_sl|_mutex)?")
YOUNG = 1.0  # seconds; a younger lock file may belong to a starting participant that has not locked it yet


def clean(directory: Path = SHARED_MEMORY, wait: Callable[[float], None] = time.sleep) -> None:
    """Remove this user's segments of dead participants; block for a second if some lock files are young."""
    if _remove_dead(directory):
        wait(YOUNG)
        _remove_dead(directory)


def remove_secrets(run: str, directory: Path = SHARED_MEMORY) -> None:
    """Remove the files of secrets that a killed endpoint has left; `endpoints.environment.secrets` makes them."""
    shutil.rmtree(directory / f"rce-secrets-{run}", ignore_errors=True)


def _remove_dead(directory: Path) -> bool:
    """Remove segments of dead participants; return True if some lock files are too young to decide."""
    young = False
    for path in _own(directory, LOCK):
        with suppress(FileNotFoundError):  # another process may clean at the same time
            if time.time() - path.stat().st_mtime < YOUNG:
                young = True  # not locked even for a test: a participant that fails to lock uses no shared memory
            elif _is_free(path):
                path.with_name(path.name.removesuffix("_el")).unlink(missing_ok=True)
                path.unlink()
    return young


def clean_ports(domain: int, directory: Path = SHARED_MEMORY) -> None:
    """Remove the ports of a ROS domain that has no participants left.

    They are numbered as in RTPS 2.5, 9.6.2.3. Ports below 7400 are kept: participants of all domains allocate them in
    order, for the reader of `ros_discovery_info`, and reuse those of dead participants.
    """
    for path in _own(directory, PORT):
        match = PORT.fullmatch(path.name)
        if match and (int(match[1]) - 7400) // 250 == domain:
            path.unlink(missing_ok=True)


def _own(directory: Path, pattern: re.Pattern[str]) -> list[Path]:
    found = []
    with os.scandir(directory) as entries:
        for each in entries:
            with suppress(FileNotFoundError):
                if pattern.fullmatch(each.name) and each.stat().st_uid == os.geteuid():
                    found.append(Path(each.path))
    return found


def _is_free(lock: Path) -> bool:
    with lock.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True
