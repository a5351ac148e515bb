"""The catalogue over HTTP: publishing, what users see of services, their use, and the bounds of instances."""

from __future__ import annotations

from typing import Any

from tests.support.master.served import Served

STRING = "std_msgs/String"
PARROT: dict[str, Any] = {
    "name": "parrot",
    "takes": {"say": STRING},
    "nodes": [{"nodeTag": "n", "pkg": "p", "exe": "secret"}],
    "robots": 2,
    "share": ["bob"],
}


async def names(served: Served, user: str) -> list[str]:
    answer = await served.ask("GET", "/catalogue", user)
    return [f"{each['user']}/{each['service']['name']}" for each in answer.body["items"]]


async def test_service_is_published_for_some_and_removed(served: Served) -> None:
    made = await served.ask("POST", "/catalogue", "ann", PARROT)
    assert (made.status, made.body["user"], made.body["service"]["share"]) == (201, "ann", ["bob"])
    assert {user: "ann/parrot" in await names(served, user) for user in ("ann", "bob", "olga")} == {
        "ann": True,
        "bob": True,
        "olga": False,
    }
    assert (await served.ask("DELETE", "/catalogue/ann/parrot", "bob")).status == 404
    assert (await served.ask("DELETE", "/catalogue/ann/parrot", "ann")).status == 204
    assert "ann/parrot" not in await names(served, "bob")


async def test_services_that_come_with_rce_are_there_for_everybody(served: Served) -> None:
    assert {"@rce/mapping2d", "@rce/mapping3d", "@rce/planning"} <= set(await names(served, "vera"))


async def test_users_see_neither_programs_nor_other_users(served: Served) -> None:
    await served.ask("POST", "/catalogue", "ann", PARROT)
    await served.robot("bob", "r1")
    await served.robot("ann", "r1")
    for user in ("ann", "bob"):
        used = await served.ask("POST", "/catalogue/ann/parrot/uses", user, {"robot": "r1"})
        assert used.status == 201, used.body
    seen = (await served.ask("GET", "/catalogue/ann/parrot", "bob")).body
    assert (seen["instances"], seen["uses"]) == ([], {"bob": 1})
    assert "secret" not in str(seen)
    own = (await served.ask("GET", "/catalogue/ann/parrot", "ann")).body
    assert own["uses"] == {"ann": 1, "bob": 1}
    assert [(each["containerTag"], each["robots"]) for each in own["instances"]] == [("parrot_1", ["ann/r1", "bob/r1"])]
    connections = (await served.ask("GET", "/connections", "bob")).body["items"]
    assert [(each["user"], each["tagA"], each["tagB"]) for each in connections] == [
        ("bob", "r1/parrot_say", "ann/parrot_1/bob_r1_say")
    ]
    assert (await served.ask("GET", "/environments/parrot_1?user=ann", "bob")).status == 404


async def test_bounds_are_changed_and_hold_at_once(served: Served) -> None:
    await served.ask("POST", "/catalogue", "ann", PARROT)
    changed = await served.ask("PATCH", "/catalogue/ann/parrot", "ann", {"least": 2, "most": 3})
    assert (changed.body["service"]["least"], len(changed.body["instances"])) == (2, 2)
    assert (await served.ask("PATCH", "/catalogue/ann/parrot", "ann", {"least": 4, "most": 3})).status == 400


async def test_instance_without_a_robot_is_an_environment_of_the_user(served: Served) -> None:
    used = await served.ask("POST", "/catalogue/@rce/planning/uses", "bob", {"containerTag": "paths"})
    assert [(each["containerTag"], each["robots"]) for each in used.body["instances"]] == [("paths", [])]
    assert (await served.ask("GET", "/environments/paths", "bob")).body["nodes"] == 1


async def test_unknown_users_and_wrong_declarations_are_refused(served: Served) -> None:
    unknown = await served.ask("POST", "/catalogue", "ann", PARROT | {"share": ["nobody"]})
    assert (unknown.status, unknown.body["field"]) == (404, "share")
    wrong = await served.ask("POST", "/catalogue", "ann", PARROT | {"takes": {"say": 3}})
    assert (wrong.status, "takes" in wrong.body["detail"]) == (400, True)
