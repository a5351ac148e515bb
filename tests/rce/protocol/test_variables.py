"""Names of environment variables that the platform reserves."""

from __future__ import annotations

import pytest

from rce.errors import InvalidRequest
from rce.protocol.variables import check_variables


@pytest.mark.parametrize(
    "name",
    [
        "RCE_TOKEN",
        "LD_PRELOAD",
        "LD_LIBRARY_PATH",
        "PYTHONPATH",
        "PYTHONSTARTUP",
        "GLIBC_TUNABLES",
        "PATH",
        "HOME",
        "ROS_DOMAIN_ID",
        "RMW_IMPLEMENTATION",
        "FASTDDS_BUILTIN_TRANSPORTS",
        "FASTRTPS_DEFAULT_PROFILES_FILE",
        "AMENT_PREFIX_PATH",
        "CYCLONEDDS_URI",
        "NUMBA_CACHE_DIR",
    ],
)
def test_reserved_variable_is_refused_by_its_name(name: str) -> None:
    with pytest.raises(InvalidRequest, match=f"variable {name} is reserved") as caught:
        check_variables(["MODE", name])
    assert caught.value.field == f"containerData.env.{name}"


def test_other_variables_are_accepted() -> None:
    check_variables(["MODE", "MY_PATH", "PATHS", "HOMEPAGE", "path", "ROS_LOG_DIR", "ROSCONSOLE_FORMAT", "RCEX", "LDX"])
    check_variables([])
