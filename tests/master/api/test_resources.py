"""Resources over HTTP: views, lists, filters and pages, and who may see them."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path
from urllib.parse import quote

import pytest
from twisted.internet.base import ReactorBase

from rce.control.calls.watching import ReadGraph, RosGraph, RosName
from rce.protocol import messages as m
from tests.support.master.served import Served, serve


@pytest.fixture
async def served(reactor: ReactorBase, tmp_path: Path) -> AsyncIterator[Served]:
    """Ann has the robot r1 connected to the environment brain with a node and a parameter; bob has an environment."""
    async with serve(reactor, tmp_path) as served:
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
        yield served


async def test_topics_and_services_are_read_from_the_environment(served: Served) -> None:
    here = RosName("/pose", ["geometry_msgs/msg/Pose2D"], 1, 2)
    served.peers["ann/brain"].answers[ReadGraph] = RosGraph([here], [RosName("/reset", ["std_srvs/srv/Empty"])])
    topics = await served.ask("GET", "/environments/brain/topics")
    assert topics.body["items"] == [
        {"name": "/pose", "types": ["geometry_msgs/msg/Pose2D"], "publishers": 1, "subscribers": 2}
    ]
    services = await served.ask("GET", "/environments/brain/services")
    assert [each["name"] for each in services.body["items"]] == ["/reset"]
    assert (await served.ask("GET", "/environments/brain/topics", user="bob")).status == 404


async def test_views_of_the_graph(served: Served) -> None:
    robot = (await served.ask("GET", "/robots")).body
    assert robot == {"items": [(await served.ask("GET", "/robots/r1")).body], "next": ""}
    assert robot["items"][0] == {
        "user": "ann",
        "robotID": "r1",
        "state": "connected",
        "endpoint": "west",
        "interfaces": 1,
        "guest": "",
    }
    environment = (await served.ask("GET", "/environments/brain")).body
    assert environment["state"] == "ready"
    assert (environment["machine"], environment["nodes"], environment["parameters"]) == ("m1", 1, 2)
    assert environment["containerData"]["group"] == "team"
    node = (await served.ask("GET", "/environments/brain/nodes/talker")).body
    assert (node["pkg"], node["exe"], node["state"]) == ("demo", "talker", "running")
    parameter = (await served.ask("GET", "/environments/brain/parameters/arm%2Fgain")).body
    assert (parameter["name"], parameter["value"], parameter["nodeTag"]) == ("arm/gain", 0.5, "")
    own = (await served.ask("GET", "/environments/brain/parameters?node=talker")).body["items"]
    assert [(each["name"], each["value"]) for each in own] == [("rate", 10)]
    interface = (await served.ask("GET", "/interfaces/brain/out")).body
    assert (interface["state"], interface["addr"], interface["connections"]) == ("ready", "/out", 1)
    (connection,) = (await served.ask("GET", "/connections")).body["items"]
    assert (connection["tagA"], connection["tagB"], connection["state"]) == ("brain/out", "r1/in", "up")
    (group,) = (await served.ask("GET", "/groups")).body["items"]
    assert group == (await served.ask("GET", "/groups/team")).body
    assert list(group["members"]) == ["brain"]


async def test_machines_need_the_right_to_read_them(served: Served) -> None:
    machines = (await served.ask("GET", "/machines", "olga")).body["items"]
    assert [(each["name"], each["role"]) for each in machines] == [("m1", "container"), ("west", "robot")]
    assert (machines[0]["slots"], machines[0]["used"], machines[0]["environments"]) == (1000, 2, 2)
    assert machines[1]["robots"] == 1
    assert (await served.ask("GET", "/machines/m1", "olga")).body == machines[0]
    assert (await served.ask("GET", "/machines/ann%2Fbrain", "olga")).status == 404  # an environment is no machine


async def test_other_users_resources_are_not_found(served: Served) -> None:
    assert [each["user"] for each in (await served.ask("GET", "/environments?user=*")).body["items"]] == ["ann"]
    theirs, nobodys = [await served.ask("GET", f"/environments/other?user={user}") for user in ("bob", "nobody")]
    assert theirs.status == nobodys.status == 404
    assert theirs.body["detail"].replace("bob", "") == nobodys.body["detail"].replace("nobody", "")
    everybodys = (await served.ask("GET", "/environments?user=*", "olga")).body["items"]
    assert [each["user"] for each in everybodys] == ["ann", "bob"]
    assert (await served.ask("GET", "/environments/other?user=bob", "root")).body["user"] == "bob"


async def test_filters(served: Served) -> None:
    async def found(path: str) -> int:
        return len((await served.ask("GET", path)).body["items"])

    assert await found("/interfaces?owner=brain") == 1
    assert await found("/interfaces?type=std_msgs/String") == 2
    assert await found("/interfaces?type=std_msgs/msg/Bool") == 0
    assert await found("/interfaces?kind=PublisherConverter") == 1
    assert await found("/connections?owner=brain") == 1
    assert await found("/connections?interface=r1/in") == 1
    assert await found("/connections?interface=r1/other") == 0
    assert await found("/environments?state=ready&machine=m1") == 1
    assert await found("/environments?machine=") == 0
    assert await found("/robots?endpoint=east") == 0


async def test_pages_list_each_item_once_while_others_change(served: Served) -> None:
    for number in range(5):
        await served.master.commands.execute("ann", m.SetParameter("brain", f"p{number}", number))
    path = "/environments/brain/parameters?node=&limit=2"
    first = (await served.ask("GET", path)).body
    await served.master.commands.execute("ann", m.DeleteParameter("brain", first["items"][1]["name"]))
    await served.master.commands.execute("ann", m.SetParameter("brain", "aa", 0))
    seen = [each["name"] for each in first["items"]]
    page = first
    while page["next"]:
        page = (await served.ask("GET", f"{path}&after={page['next'].replace('/', '%2F')}")).body
        seen += [each["name"] for each in page["items"]]
    assert seen == ["arm/gain", "p0", "p1", "p2", "p3", "p4"]


async def test_next_page_after_the_longest_names(served: Served) -> None:
    pair = quote(" ".join(["u" * 255 + "/" + "t" * 255 + "/" + "t" * 255] * 2))
    assert (await served.ask("GET", f"/connections?after={pair}")).status == 200
    assert (await served.ask("GET", f"/connections?after={quote('ü' * 1100)}")).status == 200
    assert (await served.ask("GET", f"/connections?after={quote('ü' * 1101)}")).body["field"] == "after"


@pytest.mark.parametrize(
    ("path", "field"),
    [
        *(("/robots?limit=0", "limit"), ("/robots?limit=1001", "limit"), ("/robots?limit=x", "limit")),
        *(("/robots?nonsense=1", ""), ("/robots?limit=1&limit=2", "limit"), ("/environments?state=well", "state")),
        ("/robots?user=%ff", "query"),
    ],
)
async def test_wrong_query_names_the_parameter(served: Served, path: str, field: str) -> None:
    answer = await served.ask("GET", path)
    assert (answer.status, answer.body["code"], answer.body.get("field", "")) == (400, "invalid_request", field)
    assert answer.headers["content-type"] == "application/problem+json"


async def test_wrong_method_is_refused_with_the_allowed_ones(served: Served) -> None:
    answer = await served.ask("PUT", "/robots")
    assert (answer.status, answer.headers["allow"]) == (405, "GET, HEAD")
    head = await served.ask("HEAD", "/robots/r1")
    assert (head.status, head.body) == (200, None)


async def test_forms_are_refused(served: Served) -> None:
    body = {"Content-Type": "text/plain"}
    assert (await served.ask("POST", "/packages", body=b"{}", **body)).status == 415


async def test_jobs_redirect_to_the_map_service(served: Served) -> None:
    assert (await served.ask("GET", "/jobs")).status == 404
    await served.process("service", "map-service", url="http://:9030/")
    answer = await served.ask("GET", "/jobs")
    assert (answer.status, answer.headers["location"]) == (307, "/map-service/jobs")
