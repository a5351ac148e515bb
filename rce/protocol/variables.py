"""Rules for the environment variables that users set for the nodes of an environment (`env` in containerData)."""

from __future__ import annotations

import re
from collections.abc import Iterable

from rce.errors import InvalidRequest

# These make programs load code, or keep the platform's own programs from starting if their value is wrong, or are set
# by the platform itself.
RESERVED = re.compile(
    "(RCE|LD|PYTHON|AMENT|FASTDDS|FASTRTPS|RMW|GLIBC)_.*|PYTHON.*|PATH|HOME|CYCLONEDDS_URI|NUMBA_CACHE_DIR"
    "|ROS_(DOMAIN_ID|LOCALHOST_ONLY|AUTOMATIC_DISCOVERY_RANGE|STATIC_PEERS)"
)


def check_variables(names: Iterable[str]) -> None:
    """Check the names of environment variables.

    Raises:
        InvalidRequest: A name is reserved for the platform.
    """
    for name in names:
        if RESERVED.fullmatch(name):
            raise InvalidRequest(
                f"the environment variable {name} is reserved for the platform", field=f"containerData.env.{name}"
            )
