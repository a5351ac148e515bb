"""Machines and network groups over HTTP, and invitations of machines."""

from __future__ import annotations

from pathlib import Path

from twisted.internet.base import ReactorBase

from master.access.enrolment import Inviter
from master.api.machines import MachinesApi
from master.api.router import Api
from master.api.site import Site
from master.storage.depot import Depot
from rce.api.joining import parse_join_code
from rce.protocol import messages as m
from rce.web.server import Endpoint
from tests.support.master.served import Served


async def test_machines_need_the_right_to_read_them(populated: Served) -> None:
    machines = (await populated.ask("GET", "/machines", "olga")).body["items"]
    assert [(each["name"], each["role"]) for each in machines] == [("m1", "container"), ("west", "robot")]
    assert (machines[0]["slots"], machines[0]["used"], machines[0]["environments"]) == (1000, 2, 2)
    assert machines[1]["robots"] == 1
    assert (await populated.ask("GET", "/machines/m1", "olga")).body == machines[0]
    assert (await populated.ask("GET", "/machines/ann%2Fbrain", "olga")).status == 404  # an environment is no machine
    for path in ("/machines", "/machines/m1", "/machines/nothing"):
        assert (await populated.ask("GET", path)).status == 403


async def test_machines_are_filtered(served: Served) -> None:
    await served.leave("west")
    for query, names in (
        ("?role=container", ["m1"]),
        ("?role=service", []),
        ("?state=joined", ["m1"]),
        ("?state=away", ["west"]),
        ("?limit=1&after=m1", ["west"]),
    ):
        listed = (await served.ask("GET", "/machines" + query, "olga")).body["items"]
        assert [each["name"] for each in listed] == names, query


async def test_network_group_shows_its_members(populated: Served) -> None:
    await populated.master.commands.execute("bob", m.CreateContainer("hand", m.ContainerData(group="team")))
    (group,) = (await populated.ask("GET", "/groups")).body["items"]
    assert group == (await populated.ask("GET", "/groups/team")).body
    assert (group["user"], list(group["members"])) == ("ann", ["brain"])
    everybodys = (await populated.ask("GET", "/groups?user=*", "olga")).body["items"]
    assert [(each["user"], each["group"]) for each in everybodys] == [("ann", "team"), ("bob", "team")]
    answer = await populated.ask("GET", "/groups/none")
    assert (answer.status, answer.body["field"]) == (404, "group")


async def test_removed_machine_is_gone(populated: Served) -> None:
    assert (await populated.ask("DELETE", "/machines/m1", "ann")).status == 403
    assert (await populated.ask("DELETE", "/machines/m7", "olga")).status == 404
    assert (await populated.ask("DELETE", "/machines/m1", "olga")).status == 204
    assert (await populated.ask("GET", "/machines/m1", "olga")).status == 404
    assert "m1" in populated.master.state.removed_machines


async def test_invitation_needs_a_master_that_machines_can_join(served: Served) -> None:
    assert (await served.ask("POST", "/machines/invitations", "ann", {"name": "m2"})).status == 403
    answer = await served.ask("POST", "/machines/invitations", "olga", {"name": "m2"})
    assert (answer.status, answer.body["code"]) == (404, "not_found")


async def test_invitation_has_a_join_code(served: Served, reactor: ReactorBase, tmp_path: Path) -> None:
    master = served.master
    api = Api(master.users, master.audit)
    MachinesApi(master, Inviter(master.join_tokens, "https://alpha:8081/", "f" * 64)).add_to(api)
    site = Site(master.state, api, Depot(tmp_path / "another"))
    _, served.port = await site.start(Endpoint("127.0.0.1", 0))
    body = {"name": "m2", "roles": ["robot"], "address": "10.0.0.2", "hours": 2}
    made = await served.ask("POST", "/machines/invitations", "olga", body)
    wrong = await served.ask("POST", "/machines/invitations", "olga", {"name": "no name"})
    await site.stop()
    assert (made.status, made.body["name"]) == (201, "m2")
    code = parse_join_code(made.body["code"])
    assert (code.url, code.authority) == ("https://alpha:8081/", "f" * 64)
    invited = code.invitation
    assert (invited.name, invited.roles, invited.address) == ("m2", ["robot"], "10.0.0.2")
    assert invited.expires == made.body["expires"]
    assert await master.join_tokens.redeem("m2", invited.digest, "key")
    assert (wrong.status, wrong.body["field"]) == (400, "name")
