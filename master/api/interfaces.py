"""`/api/v1/interfaces` and `/api/v1/connections`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from master import rights
from master.api.acting import acting, listing, page, principal
from master.api.calls import Answer, Call, Listing, One
from master.api.router import Api, Route
from master.service import Master
from rce.errors import NotFound
from rce.names import parse_type
from rce.views import ConnectionView, InterfaceView, Page


class Interfaces(Listing, frozen=True, forbid_unknown_fields=True):
    """Which interfaces."""

    owner: Annotated[str, Meta(description="those of this robot or environment")] = ""
    type: Annotated[str, Meta(description="those of this ROS type, in either spelling")] = ""
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

    def add_to(self, api: Api) -> None:
        one = "/interfaces/{owner}/{interface}"
        api.add(
            Route("GET", "/interfaces", self.list, "Interfaces", Interfaces, answer=Page[InterfaceView]),
            Route("GET", one, self.show, "An interface", One, answer=InterfaceView),
            Route("GET", "/connections", self.connections, "Connections", Connections, answer=Page[ConnectionView]),
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

    async def show(self, call: Call) -> Answer:
        user = acting(call, "interface.read", call.asked(One).user)
        tag = f"{call.path['owner']}/{call.path['interface']}"
        interface = self._state.interfaces.get(f"{user}/{tag}")
        if interface is None or not self._seen(call, "interface.read", user, call.path["owner"]):
            raise NotFound(f"there is no interface {tag[:160]!r}", field="interface")
        return Answer(self._master.shown.interface(interface))

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

    def _seen(self, call: Call, operation: str, user: str, owner: str) -> bool:
        return rights.sees(principal(call), self._state, operation, user, owner)
