"""Topics, services and actions of an environment over HTTP."""

from __future__ import annotations

import pytest

from rce.control.calls.robots import Definitions, DescribeType
from rce.control.calls.watching import ReadGraph, ReadPackages, RosAction, RosGraph, RosName, RosPackage, RosPackages
from rce.errors import TimedOut, UnknownType
from rce.protocol import messages as m
from tests.support.master.served import Served

TOPICS = "/environments/brain/topics"
POSE = RosName("/pose", ["geometry_msgs/msg/Pose2D"], 1, 2)


@pytest.fixture
async def served(served: Served) -> Served:
    await served.master.commands.execute("ann", m.CreateContainer("brain"))
    return served


async def test_topics_services_and_actions_are_read_from_the_environment(served: Served) -> None:
    drive = RosAction("/drive", ["a/action/Drive"], ["/driver"])
    graph = RosGraph([POSE], [RosName("/reset", ["std_srvs/srv/Empty"])], [drive])
    served.peers["ann/brain"].answers[ReadGraph] = graph
    topics = await served.ask("GET", TOPICS)
    assert topics.body["items"] == [
        {"name": "/pose", "types": ["geometry_msgs/msg/Pose2D"], "publishers": 1, "subscribers": 2}
    ]
    services = await served.ask("GET", "/environments/brain/services")
    assert [each["name"] for each in services.body["items"]] == ["/reset"]
    actions = await served.ask("GET", "/environments/brain/actions")
    assert actions.body["items"] == [
        {"name": "/drive", "types": ["a/action/Drive"], "servers": ["/driver"], "clients": []}
    ]


async def test_packages_are_read_from_the_environment(served: Served) -> None:
    served.peers["ann/brain"].answers[ReadPackages] = RosPackages([RosPackage("demo", ["echo"])])
    answer = await served.ask("GET", "/environments/brain/packages")
    assert answer.body["items"] == [{"name": "demo", "executables": ["echo"]}]


async def test_names_come_in_pages(served: Served) -> None:
    names = [RosName(name, ["a/B"]) for name in ("/c", "/a", "/b")]
    served.peers["ann/brain"].answers[ReadGraph] = RosGraph(names, [])
    first = (await served.ask("GET", TOPICS + "?limit=2")).body
    assert ([each["name"] for each in first["items"]], first["next"]) == (["/a", "/b"], "/b")
    rest = (await served.ask("GET", TOPICS + "?limit=2&after=/b")).body
    assert ([each["name"] for each in rest["items"]], rest["next"]) == (["/c"], "")


async def test_environment_that_is_not_visible_is_not_found(served: Served) -> None:
    for path, user in ((TOPICS, "bob"), (TOPICS + "?user=ann", "bob"), ("/environments/none/topics", "ann")):
        assert (await served.ask("GET", path, user)).status == 404


async def test_environment_that_does_not_answer_is_reported(served: Served) -> None:
    served.peers["ann/brain"].refuse[ReadGraph] = TimedOut("it is busy")
    answer = await served.ask("GET", TOPICS)
    assert (answer.status, answer.body["code"]) == (504, "timed_out")


async def test_definition_is_read_from_the_environment(served: Served) -> None:
    texts = {"std_srvs/srv/SetBool": "bool data\n---\nbool success\nstring message\n"}
    served.peers["ann/brain"].answers[DescribeType] = Definitions(texts)
    answer = await served.ask("GET", "/environments/brain/types?type=std_srvs/SetBool&sort=srv")
    assert (answer.status, answer.body) == (200, {"texts": texts})
    assert served.peers["ann/brain"].calls[-1] == DescribeType("ann", "std_srvs/SetBool", "srv")
    served.peers["ann/brain"].refuse[DescribeType] = UnknownType("no such type")
    answer = await served.ask("GET", "/environments/brain/types?type=a/B")
    assert answer.body["code"] == "unknown_type"
