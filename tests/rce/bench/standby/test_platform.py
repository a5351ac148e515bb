"""Command lines of the platform's processes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from rce.bench.network.bridge import Network
from rce.bench.standby.platform import ADMINISTRATOR, DATABASE, ENDPOINTS, MASTERS, TASK_SETS, Platform


@pytest.fixture
def platform(tmp_path: Path) -> Iterator[Platform]:
    (tmp_path / "database").mkdir()
    made = Platform(tmp_path / "data", Network([*MASTERS, DATABASE]), tmp_path / "database", tmp_path / "log")
    yield made
    made._out.close()


def test_masters_share_a_database_and_nothing_else(platform: Platform) -> None:
    one, other = (set(platform.programs[name]._command()) for name in MASTERS)
    assert f"--database={platform.database.url}" in one & other
    assert f"--data-dir={platform.directory / 'master-1'}" in one - other


def test_all_others_know_both_masters(platform: Platform) -> None:
    addresses = [platform.network.addresses[name] for name in MASTERS]
    masters = f"--master=tcp:{addresses[0]}:8080,tcp:{addresses[1]}:8080"
    for name in (*ENDPOINTS, *TASK_SETS):
        assert masters in platform.programs[name]._command()
    assert platform.urls == f"http://{addresses[0]}:9000/,http://{addresses[1]}:9000/"


def test_password_of_the_administrator_is_that_which_a_master_prints(platform: Platform) -> None:
    platform._take_output("The administrator is 'admin' with password 'abc'. Keep it: it is not shown again.\n")
    platform._take_output("another line\n")
    assert platform.api(ADMINISTRATOR).entry._headers != platform.api().entry._headers
    assert platform._administrator == "abc"
