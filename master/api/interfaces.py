"""`/api/v1/interfaces` and `/api/v1/connections`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from master.access import rights
from master.api.commands import Commands, created
from master.api.principals import authorize, authorize_list, page_of_records, principal_of
from master.api.request import Answer, Call, ListQuery, OwnerQuery
from master.api.router import Api, Route
from master.graph.records import Connection
from master.service import Master
from rce.api.views import ConnectionView, InterfaceView, NewConnection, NewInterface, Page
from rce.errors import InvalidRequest, NotFound
from rce.protocol import messages as m
from rce.protocol.names import TYPE, parse_type


class InterfacesQuery(ListQuery, frozen=True, forbid_unknown_fields=True):
    """Filters of interfaces."""

    owner: Annotated[str, Meta(description="of this robot or environment")] = ""
    type: Annotated[
        str,
        Meta(
            description="of this ROS type, in either spelling",
            extra_json_schema={"pattern": f"^({TYPE.pattern})?$"},
        ),
    ] = ""
    kind: Annotated[str, Meta(description="of this interfaceType")] = ""


class ConnectionsQuery(ListQuery, frozen=True, forbid_unknown_fields=True):
    """Filters of connections."""

    owner: Annotated[str, Meta(description="of this robot or environment")] = ""
    interface: Annotated[str, Meta(description="of this interface, endpointTag/interfaceTag")] = ""


class InterfacesApi:
    """Routes of interfaces and connections."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._state = master.state
        self._commands = Commands(master)

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        one = "/interfaces/{owner}/{interface}"
        pair = "/connections/{ownerA}/{interfaceA}/{ownerB}/{interfaceB}"
        made = "Connect two interfaces; the answer comes when messages can flow"
        api.add(
            Route("GET", "/interfaces", self._list, "Interfaces", InterfacesQuery, answer=Page[InterfaceView]),
            Route("POST", "/interfaces", self._add, "Add an interface", OwnerQuery, NewInterface, InterfaceView, 201),
            Route("GET", one, self._show, "An interface", OwnerQuery, answer=InterfaceView),
            Route("DELETE", one, self._remove, "Remove an interface with its connections", OwnerQuery, status=204),
            Route(
                "GET",
                "/connections",
                self._list_connections,
                "Connections",
                ConnectionsQuery,
                answer=Page[ConnectionView],
            ),
            Route("POST", "/connections", self._connect, made, OwnerQuery, NewConnection, ConnectionView, 201),
            Route("GET", pair, self._show_connection, "A connection", OwnerQuery, answer=ConnectionView),
            Route("DELETE", pair, self._disconnect, "Disconnect two interfaces", OwnerQuery, status=204),
        )

    async def _list(self, call: Call) -> Answer:
        query = call.query(InterfacesQuery)
        user = authorize_list(call, "interface.read", query.user)
        wanted = _wanted_type(query.type)

        def keep(each: InterfaceView) -> bool:
            return (
                self._sees(call, "interface.read", each.user, each.endpointTag)
                and query.owner in ("", each.endpointTag)
                and query.kind in ("", each.interfaceType)
                and wanted in ("", str(parse_type(each.className)))
            )

        return page_of_records(self._state.interfaces, user, query, self._master.presenter.interface, keep)

    async def _add(self, call: Call) -> Answer:
        wanted = call.body(NewInterface)
        command = m.AddInterface(**{name: getattr(wanted, name) for name in wanted.__struct_fields__})
        owner = await self._commands.execute(call, call.query(OwnerQuery).user, command)
        view = self._view(owner, wanted.endpointTag, wanted.interfaceTag)
        return created(call, owner, view, "interfaces", wanted.endpointTag, wanted.interfaceTag)

    async def _show(self, call: Call) -> Answer:
        user = authorize(call, "interface.read", call.query(OwnerQuery).user)
        endpoint, tag = call.path["owner"], call.path["interface"]
        if not self._sees(call, "interface.read", user, endpoint):
            raise NotFound(f"there is no interface {endpoint}/{tag}"[:200], field="interface")
        return Answer(self._view(user, endpoint, tag))

    async def _remove(self, call: Call) -> Answer:
        command = m.RemoveInterface(call.path["owner"], call.path["interface"])
        await self._commands.execute(call, call.query(OwnerQuery).user, command)
        return Answer(status=204)

    def _view(self, user: str, endpoint: str, tag: str) -> InterfaceView:
        interface = self._state.interfaces.get(f"{user}/{endpoint}/{tag}")
        if interface is None:
            raise NotFound(f"there is no interface {endpoint}/{tag}"[:200], field="interface")
        return self._master.presenter.interface(interface)

    async def _list_connections(self, call: Call) -> Answer:
        query = call.query(ConnectionsQuery)
        user = authorize_list(call, "connection.read", query.user)

        def keep(each: ConnectionView) -> bool:
            tags = (each.tagA, each.tagB)
            owners = [tag.partition("/")[0] for tag in tags]
            return (
                all(self._sees(call, "connection.read", each.user, owner) for owner in owners)
                and query.interface in ("", *tags)
                and query.owner in ("", *owners)
            )

        return page_of_records(self._state.connections, user, query, self._master.presenter.connection, keep)

    async def _connect(self, call: Call) -> Answer:
        wanted = call.body(NewConnection)
        owner = await self._commands.execute(call, call.query(OwnerQuery).user, m.Connect(wanted.tagA, wanted.tagB))
        view = self._find_connection(owner, wanted.tagA, wanted.tagB)
        return created(call, owner, view, "connections", *view.tagA.split("/"), *view.tagB.split("/"))

    async def _show_connection(self, call: Call) -> Answer:
        user = authorize(call, "connection.read", call.query(OwnerQuery).user)
        for side in ("ownerA", "ownerB"):
            if not self._sees(call, "connection.read", user, call.path[side]):
                raise NotFound("there is no such connection", field=side)
        return Answer(self._find_connection(user, *_pair(call)))

    async def _disconnect(self, call: Call) -> Answer:
        await self._commands.execute(call, call.query(OwnerQuery).user, m.Disconnect(*_pair(call)))
        return Answer(status=204)

    def _find_connection(self, user: str, one: str, other: str) -> ConnectionView:
        """Return the connection of two interfaces, given in either order.

        Raises:
            NotFound: They are not connected.
        """
        for sender, receiver in ((one, other), (other, one)):
            connection = self._state.connections.get(Connection(f"{user}/{sender}", f"{user}/{receiver}").key)
            if connection is not None:
                return self._master.presenter.connection(connection)
        raise NotFound("there is no such connection", field="ownerA")

    def _sees(self, call: Call, operation: str, user: str, owner: str) -> bool:
        return rights.sees(principal_of(call), self._state, operation, user, owner)


def _wanted_type(text: str) -> str:
    """Return the type of a query in the usual spelling; empty for all.

    Raises:
        InvalidRequest: It is not the name of a type.
    """
    try:
        return str(parse_type(text)) if text else ""
    except InvalidRequest as error:
        raise InvalidRequest(f"query.type: {error}", field="type") from None


def _pair(call: Call) -> tuple[str, str]:
    path = call.path
    return f"{path['ownerA']}/{path['interfaceA']}", f"{path['ownerB']}/{path['interfaceB']}"
