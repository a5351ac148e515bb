"""`rce bench network` over an emulated line."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rce.bench.network.line import PROFILES
from rce.bench.network.streams import PERIODS
from tests.support.e2e.bench import bench


@pytest.mark.skipif(os.geteuid() != 0, reason="network namespaces and TUN devices need root: run the tests as root")
@pytest.mark.skipif(not Path("/dev/net/tun").exists(), reason="this kernel has no TUN devices")
async def test_both_modes_are_measured_over_the_line() -> None:
    results = (await bench(200, "network", "--profiles", "lte", "--seconds", "4"))["results"]
    assert [result["mode"] for result in results] == ["rce", "plain"]
    way = PROFILES["lte"].up
    for result in results:
        assert result["streams"].keys() == PERIODS.keys()
        for name, stream in result["streams"].items():
            ages = [arrived - sent for sent, arrived in stream["times"]]
            assert ages, f"nothing of {name} arrived in mode {result['mode']}"
            assert min(ages) > way.delay - way.jitter, "nothing is faster than the line"
