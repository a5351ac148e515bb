"""Full disks of services."""

from __future__ import annotations

import errno

import pytest

from rce.services.disk import service_disk_full


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_full_disk_is_recognized(number: int) -> None:
    error = service_disk_full(OSError(number, "full"))
    assert error is not None
    assert error.info.code == "unavailable"
    assert str(error).startswith("disk full")


@pytest.mark.parametrize("error", [OSError(errno.EACCES, "denied"), ValueError("full")])
def test_other_errors_are_not_a_full_disk(error: Exception) -> None:
    assert service_disk_full(error) is None
