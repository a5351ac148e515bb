"""Limit of open files of the platform's processes."""

from __future__ import annotations

import resource
import subprocess
import sys

import pytest

from rce.process.open_files import MOST

CODE = """
import resource
from rce.process.open_files import raise_limit
resource.setrlimit(resource.RLIMIT_NOFILE, {limits})
raise_limit()
print(*resource.getrlimit(resource.RLIMIT_NOFILE))
"""
_, HARD = resource.getrlimit(resource.RLIMIT_NOFILE)


@pytest.mark.parametrize(("soft", "hard"), [(256, HARD), (256, 512), (512, 512)])
def test_limit_is_raised_as_far_as_the_system_allows(soft: int, hard: int) -> None:
    code = CODE.format(limits=(soft, hard))
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(min(hard, MOST)), str(hard)]


@pytest.mark.skipif(HARD <= MOST, reason="the system allows no more")
def test_higher_limit_stays() -> None:
    code = CODE.format(limits=(MOST + 1, HARD))
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split()[0] == str(MOST + 1)
