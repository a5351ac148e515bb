"""Fixtures: a Master with its HTTP server, without resources and with some of ann and bob."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from twisted.internet.base import ReactorBase

from rce.protocol import messages as m
from tests.support.master.package_platform import PackagePlatform, serve_packages
from tests.support.master.served import Served, serve


@pytest.fixture
async def served(reactor: ReactorBase, tmp_path: Path) -> AsyncIterator[Served]:
    async with serve(reactor, tmp_path) as served:
        yield served


@pytest.fixture
async def populated(served: Served) -> Served:
    """Ann has the robot r1 connected to the environment brain with a node and a parameter; bob has an environment."""
    await served.robot("ann", "r1")
    for command in (
        m.CreateContainer("brain", m.ContainerData(group="team")),
        m.AddNode("brain", "talker", "demo", "talker"),
        m.SetParameter("brain", "arm/gain", 0.5),
        m.SetParameter("brain", "rate", 10, "talker"),
        m.AddInterface("brain", "out", "SubscriberInterface", "std_msgs/msg/String", "/out"),
        m.AddInterface("r1", "in", "PublisherConverter", "std_msgs/String"),
        m.Connect("r1/in", "brain/out"),
    ):
        await served.master.commands.execute("ann", command)
    await served.master.commands.execute("bob", m.CreateContainer("other"))
    return served


@pytest.fixture
async def platform(reactor: ReactorBase, tmp_path: Path) -> AsyncIterator[PackagePlatform]:
    async with serve_packages(reactor, tmp_path) as platform:
        yield platform
