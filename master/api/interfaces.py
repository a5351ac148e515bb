"""`/api/v1/interfaces` and `/api/v1/connections`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from master import rights
from master.api.acting import acting, listing, page, principal
from master.api.calls import Answer, Call, Listing, One
from master.api.commands import Commands, created
from master.api.router import Api, Route
from master.records import Connection
from master.service import Master
from rce import messages as m
from rce.errors import NotFound
from rce.names import TYPE, parse_type
from rce.views import ConnectionView, InterfaceView, NewConnection, NewInterface, Page


class Interfaces(Listing, frozen=True, forbid_unknown_fields=True):
    """Which interfaces."""

    owner: Annotated[str, Meta(description="those of this robot or environment")] = ""
    type: Annotated[
        str,
        Meta(
            description="those of this ROS type, in either spelling",
            extra_json_schema={"pattern": f"^({TYPE.pattern})?$"},
        ),
    ] = ""
    kind: Annotated[str, Meta(description="those of this interfaceType")] = ""


class Connections(Listing, frozen=True, forbid_unknown_fields=True):
    """Which connections."""

    owner: Annotated[str, Meta(description="those of this robot or environment")] = ""
    interface: Annotated[str, Meta(description="those of this interface, endpointTag/interfaceTag")] = ""


class InterfacesApi:
    """Interfaces and what connects them."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._state = master.state
        self._commands = Commands(master)

    def add_to(self, api: Api) -> None:
        one = "/interfaces/{owner}/{interface}"
        pair = "/connections/{ownerA}/{interfaceA}/{ownerB}/{interfaceB}"
        made = "Connect two interfaces; answered when messages can flow"
        api.add(
            Route("GET", "/interfaces", self.list, "Interfaces", Interfaces, answer=Page[InterfaceView]),
            Route("POST", "/interfaces", self.add, "Add an interface", One, NewInterface, InterfaceView, 201),
            Route("GET", one, self.show, "An interface", One, answer=InterfaceView),
            Route("DELETE", one, self.remove, "Remove an interface with its connections", One, status=204),
            Route("GET", "/connections", self.connections, "Connections", Connections, answer=Page[ConnectionView]),
            Route("POST", "/connections", self.connect, made, One, NewConnection, ConnectionView, 201),
            Route("GET", pair, self.connection, "A connection", One, answer=ConnectionView),
            Route("DELETE", pair, self.disconnect, "Part two interfaces", One, status=204),
        )

    async def list(self, call: Call) -> Answer:
        asked = call.asked(Interfaces)
        user = listing(call, "interface.read", asked.user)
        wanted = str(parse_type(asked.type)) if asked.type else ""

        def keep(each: InterfaceView) -> bool:
            return (
                self._seen(call, "interface.read", each.user, each.endpointTag)
                and asked.owner in ("", each.endpointTag)
                and asked.kind in ("", each.interfaceType)
                and wanted in ("", str(parse_type(each.className)))
            )

        return page(self._state.interfaces, user, asked, self._master.shown.interface, keep)

    async def add(self, call: Call) -> Answer:
        wanted = call.body(NewInterface)
        command = m.AddInterface(**{name: getattr(wanted, name) for name in wanted.__struct_fields__})
        owner = await self._commands.execute(call, call.asked(One).user, command)
        view = self._shown(owner, wanted.endpointTag, wanted.interfaceTag)
        return created(call, owner, view, "interfaces", wanted.endpointTag, wanted.interfaceTag)

    async def show(self, call: Call) -> Answer:
        user = acting(call, "interface.read", call.asked(One).user)
        endpoint, tag = call.path["owner"], call.path["interface"]
        if not self._seen(call, "interface.read", user, endpoint):
            raise NotFound(f"there is no interface {endpoint}/{tag}"[:200], field="interface")
        return Answer(self._shown(user, endpoint, tag))

    async def remove(self, call: Call) -> Answer:
        command = m.RemoveInterface(call.path["owner"], call.path["interface"])
        await self._commands.execute(call, call.asked(One).user, command)
        return Answer(status=204)

    def _shown(self, user: str, endpoint: str, tag: str) -> InterfaceView:
        interface = self._state.interfaces.get(f"{user}/{endpoint}/{tag}")
        if interface is None:
            raise NotFound(f"there is no interface {endpoint}/{tag}"[:200], field="interface")
        return self._master.shown.interface(interface)

    async def connections(self, call: Call) -> Answer:
        asked = call.asked(Connections)
        user = listing(call, "connection.read", asked.user)

        def keep(each: ConnectionView) -> bool:
            tags = (each.tagA, each.tagB)
            owners = [tag.partition("/")[0] for tag in tags]
            return (
                all(self._seen(call, "connection.read", each.user, owner) for owner in owners)
                and asked.interface in ("", *tags)
                and asked.owner in ("", *owners)
            )

        return page(self._state.connections, user, asked, self._master.shown.connection, keep)

    async def connect(self, call: Call) -> Answer:
        wanted = call.body(NewConnection)
        owner = await self._commands.execute(call, call.asked(One).user, m.Connect(wanted.tagA, wanted.tagB))
        view = self._connection(owner, wanted.tagA, wanted.tagB)
        return created(call, owner, view, "connections", *view.tagA.split("/"), *view.tagB.split("/"))

    async def connection(self, call: Call) -> Answer:
        user = acting(call, "connection.read", call.asked(One).user)
        for side in ("ownerA", "ownerB"):
            if not self._seen(call, "connection.read", user, call.path[side]):
                raise NotFound("there is no such connection", field=side)
        return Answer(self._connection(user, *_pair(call)))

    async def disconnect(self, call: Call) -> Answer:
        await self._commands.execute(call, call.asked(One).user, m.Disconnect(*_pair(call)))
        return Answer(status=204)

    def _connection(self, user: str, one: str, other: str) -> ConnectionView:
        """In either order. NotFound."""
        for sender, receiver in ((one, other), (other, one)):
            connection = self._state.connections.get(Connection(f"{user}/{sender}", f"{user}/{receiver}").key)
            if connection is not None:
                return self._master.shown.connection(connection)
        raise NotFound("there is no such connection", field="ownerA")

    def _seen(self, call: Call, operation: str, user: str, owner: str) -> bool:
        return rights.sees(principal(call), self._state, operation, user, owner)


def _pair(call: Call) -> tuple[str, str]:
    path = call.path
    return f"{path['ownerA']}/{path['interfaceA']}", f"{path['ownerB']}/{path['interfaceB']}"
