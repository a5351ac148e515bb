"""Which environment variables a user may give the nodes of an environment (`env` in containerData)."""

from __future__ import annotations

import re
from collections.abc import Iterable

from rce.errors import InvalidRequest

# By these programs load code, and what the platform ships would not start with a wrong value; or they are its own.
RESERVED = re.compile(
    "(RCE|LD|PYTHON|AMENT|FASTDDS|FASTRTPS|RMW|GLIBC)_.*|PYTHON.*|PATH|HOME|CYCLONEDDS_URI|NUMBA_CACHE_DIR"
    "|ROS_(DOMAIN_ID|LOCALHOST_ONLY|AUTOMATIC_DISCOVERY_RANGE|STATIC_PEERS)"
)


def check_variables(names: Iterable[str]) -> None:
    """InvalidRequest for a name that users may not set."""
    for name in names:
        if RESERVED.fullmatch(name):
            raise InvalidRequest(f"the variable {name} is the platform's own", field=f"containerData.env.{name}")
