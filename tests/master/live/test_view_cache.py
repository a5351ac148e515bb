"""View cache: what changes marks all views that show it, and only views that differ are renewed."""

from __future__ import annotations

import json
from typing import Any

import pytest

from master.execution.readiness import Readiness
from master.graph import reconcile, sessions
from master.graph.records import Ref
from master.live.presenter import Presenter
from master.live.view_cache import KINDS, ViewCache
from rce.api.views import Kind, Usage
from rce.protocol import messages as m
from tests.support.master.fleet import Fleet, full, interface

Changes = dict[str, set[str]]


class Cache:
    """A cache of the views of a full platform."""

    def __init__(self) -> None:
        self.fleet: Fleet = full()
        self.readiness = Readiness()
        self.presenter = Presenter(self.fleet.state, self.readiness)
        self.views = ViewCache(self.presenter, self.readiness)

    def do(self, command: m.Command, user: str = "ann") -> None:
        self.fleet.do(user, command)

    def view(self, kind: Kind, key: str) -> Any:
        return json.loads(bytes(self.views.views[kind][key]))

    def take(self) -> tuple[Changes, Changes]:
        """Return keys of changed and removed views."""
        put, drop = self.views.take()
        return {kind: set(views) for kind, views in put.items()}, {kind: set(keys) for kind, keys in drop.items()}


@pytest.fixture
def cache() -> Cache:
    cache = Cache()
    cache.views.open()
    return cache


def test_open_makes_all_views(cache: Cache) -> None:
    cache.do(m.CreateContainer("second", m.ContainerData(group="g")))
    cache.views.open()
    found = {kind: list(views) for kind, views in cache.views.views.items()}
    assert found == {
        "robots": ["ann/r1", "bob/r1"],
        "environments": ["ann/brain", "ann/second"],
        "nodes": ["ann/brain/there"],
        "parameters": ["ann/brain/:rate"],
        "recorders": [],
        "interfaces": [f"ann/{tag}" for tag in INTERFACES],
        "connections": ["ann/r1/pose ann/brain/pose", "ann/r1/ask ann/brain/answer"],
        "groups": ["ann/g"],
        "machines": ["west", "m1"],  # the process of an environment is no machine
    }


INTERFACES = ["r1/pose", "brain/pose", "brain/scans", "brain/number", "brain/answer", "brain/answer2", "r1/ask"]


def test_closed_cache_keeps_and_marks_nothing(cache: Cache) -> None:
    cache.do(m.RemoveNode("brain", "there"))
    cache.views.close()
    cache.do(m.SetParameter("brain", "rate", 2))
    cache.views.mark("nodes", "ann/brain/there")
    assert cache.views.views == {}
    assert cache.views.marked == {kind: set() for kind in KINDS}


def test_stale_views_are_renewed_once(cache: Cache) -> None:
    cache.do(m.SetParameter("brain", "rate", 2))
    assert cache.view("parameters", "ann/brain/:rate")["value"] == 1
    assert cache.take() == ({"parameters": {"ann/brain/:rate"}}, {})
    assert cache.view("parameters", "ann/brain/:rate")["value"] == 2
    assert cache.take() == ({}, {})


def test_marked_view_that_is_the_same_is_not_renewed(cache: Cache) -> None:
    cache.do(m.SetParameter("brain", "rate", 2))
    cache.do(m.SetParameter("brain", "rate", 1))
    cache.views.mark("machines", "m1")
    assert cache.take() == ({}, {})


def test_record_that_came_and_went_between_is_not_mentioned(cache: Cache) -> None:
    cache.do(m.AddNode("brain", "short", "p", "e"))
    cache.do(m.RemoveNode("brain", "short"))
    assert cache.take() == ({}, {})


@pytest.mark.parametrize(
    ("command", "put", "drop"),
    [
        (m.AddNode("brain", "n", "p", "e"), {"nodes": {"ann/brain/n"}, "environments": {"ann/brain"}}, {}),
        (m.RemoveNode("brain", "there"), {"environments": {"ann/brain"}}, {"nodes": {"ann/brain/there"}}),
        (m.SetParameter("brain", "p", 1), {"parameters": {"ann/brain/:p"}, "environments": {"ann/brain"}}, {}),
        (m.DeleteParameter("brain", "rate"), {"environments": {"ann/brain"}}, {"parameters": {"ann/brain/:rate"}}),
        (interface("r1", "x", "PublisherConverter"), {"interfaces": {"ann/r1/x"}, "robots": {"ann/r1"}}, {}),
        (
            m.Disconnect("r1/pose", "brain/pose"),
            {"interfaces": {"ann/r1/pose", "ann/brain/pose"}},
            {"connections": {"ann/r1/pose ann/brain/pose"}},
        ),
        (
            m.CreateContainer("second", m.ContainerData(group="g")),
            {"environments": {"ann/second"}, "machines": {"m1"}, "groups": {"ann/g"}},
            {},
        ),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, m.Command) else "",
)
def test_command_renews_all_views_that_show_its_object(
    cache: Cache, command: m.Command, put: Changes, drop: Changes
) -> None:
    cache.do(command)
    assert cache.take() == (put, drop)


def test_last_member_takes_its_group_with_it(cache: Cache) -> None:
    cache.do(m.CreateContainer("second", m.ContainerData(group="g")))
    cache.take()
    cache.do(m.DestroyContainer("second"))
    assert cache.take() == ({"machines": {"m1"}}, {"environments": {"ann/second"}, "groups": {"ann/g"}})


def test_robot_renews_the_count_of_its_endpoint(cache: Cache) -> None:
    cache.fleet.robot("cid/r1")
    assert cache.take() == ({"robots": {"cid/r1"}, "machines": {"west"}}, {})
    sessions.robot_left(cache.fleet.state, "cid/r1")
    assert cache.take() == ({"machines": {"west"}}, {"robots": {"cid/r1"}})


@pytest.mark.parametrize(
    ("ref", "put"),
    [
        (Ref("node", "ann/brain/there"), {"nodes": {"ann/brain/there"}}),
        (Ref("environment", "ann/brain"), {"environments": {"ann/brain"}}),
        (Ref("interface", "ann/r1/pose"), {"interfaces": {"ann/r1/pose"}}),
        (Ref("link", "unknown"), {}),
    ],
)
def test_what_becomes_ready_renews_its_view(cache: Cache, ref: Ref, put: Changes) -> None:
    cache.readiness.mark_ready(ref)
    assert cache.take() == (put, {})


@pytest.mark.parametrize(
    ("process", "put"),
    [
        ("west", {"machines": {"west"}, "robots": {"ann/r1", "bob/r1"}}),
        ("ann/brain", {"environments": {"ann/brain"}}),
        ("m1", {"machines": {"m1"}}),
    ],
)
def test_process_that_is_lost_renews_what_shows_its_state(cache: Cache, process: str, put: Changes) -> None:
    reconcile.left(cache.fleet.state, process)
    cache.views.process_moved(process)
    assert cache.take() == (put, {})


def test_measured_figures_are_in_marked_views(cache: Cache) -> None:
    cache.presenter.usage = {"ann/brain": Usage(0.5, 1000)}
    cache.views.mark("environments", "ann/brain")
    assert cache.take() == ({"environments": {"ann/brain"}}, {})
    assert cache.view("environments", "ann/brain")["usage"] == {"cores": 0.5, "memory": 1000}
