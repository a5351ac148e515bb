"""Cases and actors of the matrix of rights, and the world of resources in which they are tried."""

from __future__ import annotations

import asyncio
import http.client
import json
import time
from typing import Any, NamedTuple

from master.execution.effect_runner import new_id
from master.graph import catalogue, secrets
from master.graph.records import Package, Version
from rce.api.roles import Scopes, UserRole
from rce.api.views import NewOffer
from rce.control.calls.recordings import ListRecordings, Piece, ReadRecording, RecordingInfo, Recordings
from rce.control.calls.robots import Login
from rce.protocol import messages as m
from tests.support.master.served import Served

GOOD = "correct horse battery"
DIGEST = "a" * 64
STRING = "std_msgs/String"


class Case(NamedTuple):
    """Request that tries a route.

    `user_in` is where another user is named: `query`, `path`, nowhere (`own`), or `platform` if it belongs to no user.
    """

    operation: str
    user_in: str = "query"
    body: Any = None
    also_accepted: tuple[int, ...] = ()  # statuses that count as success


NODE = {"nodeTag": "fresh", "pkg": "p", "exe": "x"}
SHARES = {"users": ["vera"]}
CASES: dict[str, Case | None] = {
    "GET /whoami": Case("whoami", "own"),
    "GET /users": Case("user.read", "own"),
    "POST /users": Case("user.create", "platform", {"name": "carl", "password": GOOD}),
    "GET /users/{name}": Case("user.read", "path"),
    "PATCH /users/{name}": Case("user.change", "path", {"role": "user"}),
    "DELETE /users/{name}": Case("user.remove", "path"),
    "PUT /users/{name}/password": Case("password.change", "path", {"new": GOOD, "old": GOOD}),
    "GET /users/{name}/limits": Case("limits.read", "path"),
    "PATCH /users/{name}/limits": Case("limits.change", "path", {"pids": 10_000}),
    "GET /users/{name}/usage": Case("usage.read", "path"),
    "GET /keys": Case("key.read"),
    "POST /keys": Case("key.create", body={}),
    "GET /keys/{key}": Case("key.read"),
    "DELETE /keys/{key}": Case("key.revoke"),
    "POST /keys/{key}/rotate": Case("key.rotate"),
    "GET /audit": Case("audit.read", "own"),
    "GET /robots": Case("robot.read"),
    "GET /robots/{robot}": Case("robot.read"),
    "DELETE /robots/{robot}": Case("robot.disconnect"),
    "GET /environments": Case("environment.read"),
    "POST /environments": Case("environment.create", body={"containerTag": "fresh"}),
    "GET /environments/{environment}": Case("environment.read"),
    "DELETE /environments/{environment}": Case("environment.remove"),
    "GET /environments/{environment}/nodes": Case("node.read"),
    "POST /environments/{environment}/nodes": Case("node.create", body=NODE),
    "GET /environments/{environment}/nodes/{node}": Case("node.read"),
    "DELETE /environments/{environment}/nodes/{node}": Case("node.remove"),
    "GET /environments/{environment}/parameters": Case("parameter.read"),
    "POST /environments/{environment}/parameters": Case("parameter.set", body={"name": "rate", "value": 2}),
    "GET /environments/{environment}/parameters/{name}": Case("parameter.read"),
    "DELETE /environments/{environment}/parameters/{name}": Case("parameter.remove"),
    "GET /environments/{environment}/recorders": Case("recorder.read"),
    "POST /environments/{environment}/recorders": Case("recorder.create", body={"recorderTag": "fresh"}),
    "GET /environments/{environment}/recorders/{recorder}": Case("recorder.read"),
    "DELETE /environments/{environment}/recorders/{recorder}": Case("recorder.remove"),
    "GET /recordings": Case("recording.read"),
    "POST /recordings": Case("recording.upload", also_accepted=(400,)),  # without the headers of tus
    "GET /recordings/{machine}/{recording}": Case("recording.read"),
    "PATCH /recordings/{machine}/{recording}": Case("recording.upload", also_accepted=(415,)),  # with JSON
    "DELETE /recordings/{machine}/{recording}": Case("recording.remove"),
    "GET /recordings/{machine}/{recording}/file": Case("recording.read"),
    "GET /environments/{environment}/topics": Case("interface.read"),
    "GET /environments/{environment}/packages": Case("interface.read"),
    "GET /environments/{environment}/services": Case("interface.read"),
    "GET /environments/{environment}/actions": Case("interface.read"),
    "GET /environments/{environment}/types": Case("interface.read"),
    "GET /interfaces": Case("interface.read"),
    "POST /interfaces": Case(
        "interface.create",
        body={
            "endpointTag": "brain",
            "interfaceTag": "fresh",
            "interfaceType": "PublisherInterface",
            "className": STRING,
        },
    ),
    "GET /interfaces/{owner}/{interface}": Case("interface.read"),
    "DELETE /interfaces/{owner}/{interface}": Case("interface.remove"),
    "GET /interfaces/{owner}/{interface}/trace": Case("trace.read"),
    "GET /connections": Case("connection.read"),
    "POST /connections": Case("connection.create", body={"tagA": "r1/spare", "tagB": "brain/spare"}),
    "GET /connections/{ownerA}/{interfaceA}/{ownerB}/{interfaceB}": Case("connection.read"),
    "DELETE /connections/{ownerA}/{interfaceA}/{ownerB}/{interfaceB}": Case("connection.remove"),
    "GET /machines": Case("machine.read", "platform"),
    "GET /machines/{name}": Case("machine.read", "platform"),
    "POST /machines/invitations": Case("machine.invite", "platform", {"name": "m9"}, (404,)),
    "DELETE /machines/{name}": Case("machine.remove", "platform", also_accepted=(404,)),  # of no machine
    "GET /groups": Case("group.read"),
    "GET /groups/{group}": Case("group.read"),
    "GET /packages": Case("package.read", "own"),
    "POST /packages": Case("package.push", "own", {"name": "new", "digest": "b" * 64, "size": 9}, (413,)),
    "DELETE /packages/{name}": Case("package.remove", "own"),
    "DELETE /packages/{name}/versions/{version}": Case("package.remove", "own"),
    "POST /packages/{name}/shares": Case("package.share", "own", SHARES),
    "DELETE /packages/{name}/shares": Case("package.share", "own", SHARES),
    "DELETE /packages/{name}/shares/{other}": Case("package.share", "own"),
    "GET /catalogue": Case("catalogue.read", "own"),
    "POST /catalogue": Case("catalogue.publish", "own", {"name": "parrot"}),
    "GET /catalogue/{publisher}/{name}": Case("catalogue.read", "own"),
    "PATCH /catalogue/{publisher}/{name}": Case("catalogue.publish", "path", {"least": 0, "most": 3}),
    "DELETE /catalogue/{publisher}/{name}": Case("catalogue.publish", "path"),
    "POST /catalogue/{publisher}/{name}/uses": Case("service.use", body={"containerTag": "fresh"}),
    "GET /secrets": Case("secret.read", "own"),
    "POST /secrets": Case("secret.set", "own", {"name": "database", "value": "hidden"}),
    "DELETE /secrets/{name}": Case("secret.remove", "own"),
    "PUT /uploads": None,  # with a ticket
    "GET /archives": None,
    "GET /environments/{environment}/log": Case("environment.log"),
    "GET /environments/{environment}/nodes/{node}/log": Case("node.log"),
    "GET /events": Case("feed.read"),
    "GET /jobs": Case("job.read", "own", None, (404,)),  # no map service has joined
    "GET /services": Case("job.read", "own"),
    "GET /openapi.json": None,  # public
}
EXISTING = {
    "environment": "brain",
    "node": "talker",
    "recorder": "box",
    "machine": "m1",
    "recording": "0f3c",
    "owner": "brain",
    "interface": "out",
    "robot": "r1",
    "group": "team",
    "ownerA": "r1",
    "interfaceA": "in",
    "ownerB": "brain",
    "interfaceB": "out",
    "version": DIGEST,
    "other": "vera",
}
HIDDEN = EXISTING | {"environment": "attic", "owner": "attic", "robot": "r2", "ownerA": "r2", "ownerB": "attic"}
MISSING = {name: f"no{tag}" for name, tag in EXISTING.items()}
HIDDEN_BODIES = {"brain": "attic", "r1/spare": "r2/spare", "brain/spare": "attic/spare"}
SELF_DESTRUCTIVE = ("PATCH /users/{name}", "DELETE /users/{name}")  # after these the actor could not go on
USERS = ("ann", "bob", "olga", "root")


class Actor(NamedTuple):
    user: str
    column: str  # column of RIGHTS; or expired, metrics
    role: Any
    scopes: Scopes = Scopes()


ACTORS = {
    "viewer": Actor("ann", "viewer", "viewer"),
    "user": Actor("ann", "user", "user"),
    "robot": Actor("ann", "robot", "robot"),
    "tied": Actor("ann", "tied", "robot", Scopes("r1", ["brain", "fresh"])),
    "expired": Actor("ann", "expired", "user"),
    "operator": Actor("olga", "operator", "operator"),
    "admin": Actor("root", "admin", "admin"),
    "metrics": Actor("root", "metrics", "admin", Scopes(metrics=True)),
}


class World:
    """Users who all have robots r1 and r2, environments brain and attic, and the same things in them."""

    def __init__(self, served: Served) -> None:
        self.served = served
        self.keys: dict[str, str] = {}  # id of a key of each user, made with the actor's and within its role
        self.secret = ""
        kept = RecordingInfo("0f3c", "a.mcap", "complete", 0, 0.0)
        served.peers["m1"].answers |= {ListRecordings: Recordings([kept]), ReadRecording: Piece(b"")}
        self._actor = ACTORS["user"]
        self._own_key = ""

    async def begin(self, actor: Actor) -> None:
        expires = time.time() + (-1 if actor.column == "expired" else 1000)
        self.secret, key = await self.served.master.users.keys.add(actor.user, actor.role, "", expires, actor.scopes)
        self._actor, self._own_key, self.keys = actor, key.id, {}
        for user in USERS:
            await self.served.master.users.change_password(user, GOOD)
            await self.restore(user)

    async def restore(self, user: str) -> None:
        """Create what a user lacks, and remove what a case created."""
        master, state = self.served.master, self.served.master.state
        if user not in await master.users.names():
            await master.users.add(user, GOOD)
        if self.keys.get(user) not in {key.id for key in await master.users.keys.of(user)}:
            role: UserRole = "viewer" if self._actor.role == "viewer" else "robot"
            self.keys[user] = (await master.users.keys.add(user, role, parent=self._own_key))[1].id
        for tag in ("r1", "r2"):
            if f"{user}/{tag}" not in state.robots:
                secret, _ = await master.users.keys.add(user, "robot")
                await self.served.call_master("west", Login(user, tag, secret))
        for command in self._lacking(user):
            await master.commands.execute(user, command)
        state.packages.put(Package(f"{user}/tool", [Version(DIGEST, 1, [], 0.0)], ["vera"]))
        secrets.put(state, user, "rate", "sealed", 1.0)
        catalogue.publish(state, user, NewOffer("parrot", robots=2, share=["vera"]), new_id)

    def _lacking(self, user: str) -> list[m.Command]:
        state = self.served.master.state
        wanted: list[m.Command] = []
        connected = {each.key for each in state.connections}
        if f"{user}/fresh" in state.environments:
            wanted.append(m.DestroyContainer("fresh"))
        for robot, environment in (("r1", "brain"), ("r2", "attic")):
            if f"{user}/{environment}" not in state.environments:
                wanted.append(m.CreateContainer(environment, m.ContainerData(group="team")))
            if f"{user}/{environment}/talker" not in state.nodes:
                wanted.append(m.AddNode(environment, "talker", "p", "x"))
            if f"{user}/{environment}/box" not in state.recorders:
                wanted.append(m.AddRecorder(environment, "box"))
            if f"{user}/{environment}/fresh" in state.recorders:
                wanted.append(m.RemoveRecorder(environment, "fresh"))
            if f"{user}/{environment}/:rate" not in state.parameters:
                wanted.append(m.SetParameter(environment, "rate", 1))
            for owner, tag, kind in (
                *((robot, tag, "SubscriberConverter") for tag in ("in", "spare")),
                *((environment, tag, "PublisherInterface") for tag in ("out", "spare")),
            ):
                if f"{user}/{owner}/{tag}" not in state.interfaces:
                    wanted.append(m.AddInterface(owner, tag, kind, STRING))
            sides = f"{user}/{environment}/{{}} {user}/{robot}/{{}}"
            joined = sides.format("out", "in")
            if not {joined, _reversed(joined)} & connected:
                wanted.append(m.Connect(f"{robot}/in", f"{environment}/out"))
            if f"{user}/{environment}/fresh" in state.nodes:
                wanted.append(m.RemoveNode(environment, "fresh"))
            if f"{user}/{environment}/fresh" in state.interfaces:
                wanted.append(m.RemoveInterface(environment, "fresh"))
            spare = sides.format("spare", "spare")
            if {spare, _reversed(spare)} & connected:
                wanted.append(m.Disconnect(f"{robot}/spare", f"{environment}/spare"))
        return wanted

    async def ask(self, route: str, case: Case, user: str, tags: dict[str, str], caller: str) -> tuple[int, Any]:
        """Try a route on resources of `user`."""
        method, _, path = route.partition(" ")
        body = case.body
        if tags is HIDDEN and isinstance(body, dict):
            body = {key: HIDDEN_BODIES.get(value, value) for key, value in body.items()}
        there = tags is not MISSING
        if "/users" in path:
            name = user
        elif path.startswith(("/packages", "/machines")):
            there = there and case.operation != "machine.remove"  # the others need the machine
            name = {True: {"p": "tool", "m": "m1"}[path[1]], False: "nothing"}[there]
        elif path.startswith("/catalogue"):
            name = ("planning" if path.endswith("/uses") else "parrot") if there else "nothing"
        else:
            name = "rate" if there else "norate"
        publisher = "@rce" if path.endswith("/uses") else user
        names = tags | {"name": name, "publisher": publisher, "key": self.keys.get(user, "0123") if there else "beef"}
        path = path.format(**names)
        queries = {"/trace": ["seconds=0"], "/types": [f"type={STRING}"]}
        query = next((words for end, words in queries.items() if path.endswith(end)), [])
        if case.user_in == "query" and user != caller:
            query.append(f"user={user}")
        path += "?" * bool(query) + "&".join(query)
        return await self.at(method, "/api/v1" + path, body)

    async def at(self, method: str, path: str, body: Any = None) -> tuple[int, Any]:
        """Return status and JSON of a request."""
        return await asyncio.to_thread(self._ask, method, path, body)

    def _ask(self, method: str, path: str, body: Any) -> tuple[int, Any]:
        connection = http.client.HTTPConnection("127.0.0.1", self.served.port, timeout=20)
        headers = {"Authorization": f"Bearer {self.secret}", "Connection": "close", "Content-Type": "application/json"}
        content = None if body is None else json.dumps(body)
        try:
            connection.request(method, path, content, headers)
            answer = connection.getresponse()
            text = answer.read() if "json" in answer.headers.get_content_type() else b""
            return answer.status, json.loads(text) if text else None
        finally:
            connection.close()


def _reversed(sides: str) -> str:
    return " ".join(reversed(sides.split(" ")))


def without_names(answer: tuple[int, Any], *names: str) -> str:
    """Return an answer as text, with these names replaced."""
    text = json.dumps(answer)
    for name in sorted(names, key=len, reverse=True):
        text = text.replace(name, "~")
    return text
