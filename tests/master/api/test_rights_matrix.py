"""Matrix of rights: every role tries every route and every command, on its own, hidden and other users' resources.

Allowed requests succeed. Other users' resources get the same answer as those that do not exist.
"""

from __future__ import annotations

import json
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from twisted.internet.base import ReactorBase

from master.access.rights import COLUMNS, COMMANDS, RIGHTS
from master.api.resources import make_api
from master.storage.depot import Depot
from rce.api.roles import Scopes
from rce.control.calls.call import Call
from rce.control.calls.robots import Execute, Login, SessionExpired
from rce.errors import RceError
from rce.protocol import messages as m
from tests.support.master.rights_matrix import (
    ACTORS,
    CASES,
    EXISTING,
    HIDDEN,
    MISSING,
    SELF_DESTRUCTIVE,
    STRING,
    USERS,
    Actor,
    Case,
    World,
    without_names,
)
from tests.support.master.served import serve

pytestmark = pytest.mark.slow  # every role tries every route and command


@pytest.fixture
async def world(reactor: ReactorBase, tmp_path: Path) -> AsyncIterator[World]:
    async with serve(reactor, tmp_path) as served:
        yield World(served)


async def test_every_route_has_a_case(world: World, tmp_path: Path) -> None:
    api = make_api(world.served.master, Depot(tmp_path / "d"))
    assert {f"{route.method} {route.path}" for route in api.routes} <= set(CASES)
    assert {case.operation for case in CASES.values() if case} <= set(RIGHTS)


@pytest.mark.parametrize("name", ACTORS)
async def test_routes(world: World, name: str, tmp_path: Path) -> None:
    actor = ACTORS[name]
    api = make_api(world.served.master, Depot(tmp_path / "d"))
    await world.begin(actor)
    routes = {f"{route.method} {route.path}" for route in api.routes}
    for route, case in CASES.items():
        if case is None or route not in routes:
            continue
        if actor.column in ("expired", "metrics"):
            reach = "own" if case.operation == "whoami" and actor.column == "metrics" else "-"
        else:
            reach = RIGHTS[case.operation][actor.column]
        if reach == "all" and route in SELF_DESTRUCTIVE:
            await _try_on_other_users(world, actor, route, case, reach)
            continue
        status, answer = await world.ask(route, case, actor.user, EXISTING, actor.user)
        what = f"{name}: {route} on own resources: {status} {answer}"
        if actor.column == "expired":
            assert status == 401, what
        elif reach == "-" or (case.user_in == "platform" and reach != "all"):
            assert status == 403, what
        else:
            assert status < 400 or status in case.also_accepted, what
        await world.restore(actor.user)
        if case.user_in in ("query", "path"):
            await _try_on_other_users(world, actor, route, case, reach)
        if actor.column == "tied" and reach == "own" and "{" in route + json.dumps(case.body):
            await _try_on_hidden(world, actor, route, case)


async def _try_on_other_users(world: World, actor: Actor, route: str, case: Case, reach: str) -> None:
    without = (("bob", MISSING), ("nobody", EXISTING), ("nobody", MISSING)) if reach != "all" else ()
    tried = (*without, ("bob", EXISTING))
    answers = [await world.ask(route, case, user, tags, actor.user) for user, tags in tried]
    expected = {"expired": (401,)}.get(actor.column, {"-": (403,), "own": (404,), "all": (200, 201, 204)}[reach])
    what = f"{actor.column}: {route} on other users' resources: {answers}"
    assert answers[-1][0] in (*expected, *case.also_accepted), what
    if reach != "all":
        said = {
            without_names(answer, "bob", "nobody", *EXISTING.values(), *MISSING.values(), *world.keys.values())
            for answer in answers
        }
        assert len(said) == 1, what
    await world.restore("bob")


async def _try_on_hidden(world: World, actor: Actor, route: str, case: Case) -> None:
    """Try a route on resources of the user to which the key is not restricted."""
    if not any(f"{{{tag}}}" in route for tag in ("environment", "owner", "ownerA", "robot")):
        return
    hidden = await world.ask(route, case, actor.user, HIDDEN, actor.user)
    missing = await world.ask(route, case, actor.user, MISSING, actor.user)
    assert hidden[0] == 404, f"{route} on a hidden resource: {hidden}"
    names = (*HIDDEN.values(), *MISSING.values(), "norate", "rate")
    assert without_names(hidden, *names) == without_names(missing, *names), f"{route}: {hidden} {missing}"


async def test_lists_have_what_the_user_may_see(world: World) -> None:
    lists = [route for route in CASES if route.startswith("GET ") and "{" not in route]
    for name in ("tied", "viewer", "operator"):
        actor = ACTORS[name]
        await world.begin(actor)
        seen: dict[str, set[tuple[str, str]]] = {}
        for route in lists:
            case = CASES[route]
            if case is None or case.user_in != "query" or route in ("GET /keys", "GET /events"):
                continue
            status, answer = await world.ask(route, case, "*", EXISTING, actor.user)
            if status == 200:
                for each in answer["items"]:
                    tags = [each.get(tag, "") for tag in ("robotID", "containerTag", "endpointTag", "tagA", "tagB")]
                    seen.setdefault(route, set()).update((each["user"], tag.partition("/")[0]) for tag in tags if tag)
        users = USERS if name == "operator" else ("ann",)
        visible = {"r1", "brain"} if name == "tied" else {"r1", "r2", "brain", "attic"}
        for route in ("GET /robots", "GET /environments", "GET /interfaces", "GET /connections"):
            assert {user for user, _ in seen[route]} == set(users), (name, route)
            assert {tag for _, tag in seen[route]} <= visible, (name, route)
        assert {tag for _, tag in seen["GET /connections"]} == visible


@pytest.mark.parametrize("name", ACTORS)
async def test_metrics(world: World, name: str) -> None:
    actor = ACTORS[name]
    await world.begin(actor)
    good = 200 if actor.column in ("operator", "admin", "metrics") else 401 if actor.column == "expired" else 403
    for path in ("/metrics", "/metrics/targets"):
        assert (await world.at("GET", path))[0] == good
    missing = [await world.at("GET", path) for path in ("/metrics/nothing", "/metrics/bob/nothing")]
    assert [status for status, _ in missing] == [404 if good == 200 else good] * 2
    if good != 200:
        assert await world.at("GET", "/metrics/bob/brain") == missing[1]


# --- robots -----------------------------------------------------------------------------------------------------------


def commands(robot: str, environment: str, node: str = "talker") -> list[m.Command]:
    """One of each."""
    return [
        m.AddNode(environment, "fresh", "p", "x"),
        m.RemoveNode(environment, node),
        m.SetParameter(environment, "rate", 2),
        m.DeleteParameter(environment, "rate"),
        m.AddRecorder(environment, "fresh"),
        m.RemoveRecorder(environment, "box"),
        m.AddInterface(robot, "fresh", "SubscriberConverter", STRING),
        m.AddInterface(environment, "fresh", "PublisherInterface", STRING),
        m.Connect(f"{robot}/spare", f"{environment}/spare"),
        m.Disconnect(f"{robot}/in", f"{environment}/out"),
        m.RemoveInterface(robot, "in"),
        m.RemoveInterface(environment, "out"),
        m.DestroyContainer(environment),
        m.UseService("planning", environment),
        m.LeaveService(environment),
        m.DestroyContainer(environment),
        m.CreateContainer(environment),
    ]


async def outcome(world: World, call: Call[Any]) -> str:
    """`ok`, or what is said."""
    try:
        await world.served.call_master("west", call)
    except RceError as error:
        return f"{error.info.code}: {error}"
    except AssertionError as error:  # a command that was refused
        return str(error)
    return "ok"


@pytest.mark.parametrize("name", ACTORS)
async def test_commands_of_robots(world: World, name: str) -> None:
    actor = ACTORS[name]
    assert {type(command) for command in commands("r1", "brain")} == set(COMMANDS)
    await world.begin(actor)
    await world.served.master.sessions.disconnect(f"{actor.user}/r1", "the test takes its place")
    came = await outcome(world, Login(actor.user, "r1", world.secret))
    column = actor.column
    if column in ("expired", "metrics") or RIGHTS["robot.connect"][column] == "-":
        codes = {"expired": "unauthorized", "viewer": "forbidden", "admin": "invalid_request"}
        assert codes.get(column, "invalid_request") in came
        for command in commands("r1", "brain"):
            assert "has no session" in await outcome(world, Execute.of(f"{actor.user}/r1", command))
        return
    assert came == "ok"
    assert "unauthorized" in await outcome(world, Login("bob", "r1", world.secret))
    await world.restore(actor.user)
    for command in commands("r1", "brain"):
        assert await outcome(world, Execute.of(f"{actor.user}/r1", command)) == "ok", (name, command)
    await world.restore(actor.user)
    if column == "tied":
        assert "forbidden" in await outcome(world, Login("ann", "r2", world.secret))
        for hidden, missing in zip(commands("r2", "attic"), commands("r9", "annex"), strict=True):
            said, of_missing = [await outcome(world, Execute.of("ann/r1", each)) for each in (hidden, missing)]
            assert "not_found" in said or "forbidden" in said
            same = of_missing.replace("r9", "r2").replace("annex", "attic")
            assert said == same


# --- guests -----------------------------------------------------------------------------------------------------------

GUEST = "@desk"
LISTENS: list[m.Command] = [
    m.AddInterface(GUEST, "ear", "PublisherConverter", STRING),
    m.AddInterface("brain", f"{GUEST}.ear", "SubscriberInterface", STRING, "/said"),
    m.Connect(f"brain/{GUEST}.ear", f"{GUEST}/ear"),
    m.Disconnect(f"brain/{GUEST}.ear", f"{GUEST}/ear"),
    m.RemoveInterface("brain", f"{GUEST}.ear"),
    m.RemoveInterface(GUEST, "ear"),
]
SPEAKS: list[m.Command] = [
    *(
        m.AddInterface(GUEST, f"new{number}", kind, STRING)
        for number, kind in enumerate(
            ("SubscriberConverter", "SubscriberForwarder", "ServiceClientConverter", "ServiceProviderForwarder")
        )
    ),
    *(
        m.AddInterface("brain", f"{GUEST}.new{number}", kind, STRING, "/said")
        for number, kind in enumerate(("PublisherInterface", "ServiceClientInterface", "ServiceProviderInterface"))
    ),
]
NOT_ITS_OWN: list[m.Command] = [
    m.AddInterface("brain", "plain", "SubscriberInterface", STRING, "/said"),
    m.AddInterface("r1", "plain", "PublisherConverter", STRING),
    m.Connect("brain/@another.ear", f"{GUEST}/ear"),
    m.Connect("r1/spare", "brain/spare"),
    m.AddNode("brain", f"{GUEST}.shell", "p", "x"),
]


@pytest.mark.parametrize("owner", ["own", "bob"])
@pytest.mark.parametrize("name", ACTORS)
async def test_commands_of_guests(world: World, name: str, owner: str) -> None:
    actor = ACTORS[name]
    await world.begin(actor)
    state = world.served.master.state
    user = actor.user if owner == "own" else owner
    column = actor.column if actor.column in COLUMNS else ""

    def may(operation: str) -> bool:
        reach = RIGHTS[operation][column] if column else "-"
        return reach == "all" or (reach == "own" and user == actor.user)

    login = Login(actor.user, GUEST, world.secret, owner=user)
    if column == "tied":
        assert ("tied to robotID r1" if owner == "own" else "not_found") in await outcome(world, login)
        return
    came = await outcome(world, login)
    assert (came == "ok") == may("data.read"), (name, came)
    if came != "ok":
        nobody = await outcome(world, Login(actor.user, GUEST, world.secret, owner="eve"))
        assert came.replace(user, "eve") == nobody  # of whom there is none
        assert f"{user}/{GUEST}" not in state.robots
        return
    usage = (state.robots_of_user("bob"), state.connections_of_user("bob"))
    tried: tuple[tuple[str, Sequence[m.Command]], ...] = (
        ("data.read", LISTENS),
        ("data.write", SPEAKS),
        ("", commands("r1", "brain")[:9]),
        ("", NOT_ITS_OWN[-2:]),
    )
    for operation, each in ((operation, each) for operation, all_of in tried for each in all_of):
        said = await outcome(world, Execute.of(f"{user}/{GUEST}", each))
        assert (said == "ok") == may(operation or COMMANDS[type(each)]), (name, each, said)
        assert said == "ok" or "forbidden" in said
        await world.restore(user)
    for listens in LISTENS[:3]:
        assert await outcome(world, Execute.of(f"{user}/{GUEST}", listens)) == "ok"
    if user != actor.user:
        assert usage == (state.robots_of_user("bob"), state.connections_of_user("bob"))
    await world.served.call_master("west", SessionExpired(f"{user}/{GUEST}"))
    left = [each.key for table in state.tables() for each in table if "/@" in each.key]
    assert left == []


async def test_viewer_gains_no_rights_by_a_guest(world: World) -> None:
    """Names that begin with its own are its own in environments only: a robot would hear what it sends."""
    await world.begin(ACTORS["viewer"])
    assert await outcome(world, Login("ann", GUEST, world.secret)) == "ok"
    for command in (*NOT_ITS_OWN, m.AddInterface("r1", f"{GUEST}.x", "PublisherConverter", STRING)):
        assert "forbidden" in await outcome(world, Execute.of(f"ann/{GUEST}", command)), command
    for command in (
        m.AddInterface("r1", f"{GUEST}.x", "SubscriberInterface", STRING),
        m.AddInterface("brain", "@another.x", "SubscriberInterface", STRING),
    ):
        assert await outcome(world, Execute.of(f"ann/{GUEST}", command)) != "ok", command


async def test_guest_with_a_key_restricted_to_environments(world: World) -> None:
    await world.begin(ACTORS["user"])
    secret, _ = await world.served.master.users.keys.add("ann", "robot", scopes=Scopes(environments=["brain"]))
    assert await outcome(world, Login("ann", GUEST, secret)) == "ok"
    for number, kind in enumerate(("SubscriberInterface", "PublisherInterface")):
        for environment, expected in (("brain", "ok"), ("attic", "not_found"), ("annex", "not_found")):
            command = m.AddInterface(environment, f"{GUEST}.x{number}", kind, STRING)
            assert expected in await outcome(world, Execute.of(f"ann/{GUEST}", command))
