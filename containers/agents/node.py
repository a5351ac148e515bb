"""Work of an agent on its node that does not depend on what runs the containers.

It serves the sockets of environments, as the task set does with the engine `docker`, relays data links, and keeps the
connection to its task set.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct
from twisted.internet.base import ReactorBase
from twisted.logger import Logger

from containers.agents.connections import ROLE
from containers.control_relay import ControlRelay
from containers.data_relay import DataRelay
from containers.data_socket import DataSocket
from containers.fetching import Fetcher
from rce import __version__
from rce.control.calls.agents import SetMaster
from rce.control.calls.call import Call, Nothing
from rce.control.calls.environments import SetRelays
from rce.control.calls.joining import Hello, SetRemovedMachines, Welcome
from rce.control.client import ControlClient
from rce.control.connection import Handlers
from rce.errors import RceError
from rce.net.tls import load_tls
from rce.process.metrics import Family

log = Logger()


class NodeSettings(Struct, frozen=True, kw_only=True):
    """Settings of every agent."""

    master: Annotated[str, Meta(description="control address of the Master")]
    task_set: Annotated[str, Meta(description="control address of the task set")]
    token: Annotated[str, Meta(description="secret that the task set shares with its agents")]
    node: Annotated[str, Meta(description="id of this node")]
    tls: Annotated[Path | None, Meta(description="directory with ca.pem, cert.pem and key.pem of this node")] = None
    data_port: Annotated[int, Meta(description="port for data links; 0 takes a free one")] = 0
    entry: Annotated[str, Meta(description="URL of the Master's HTTP entry; empty: on the host of `master`")] = ""


@dataclass
class _Served:
    """An environment whose sockets are open."""

    name: str
    relay: ControlRelay
    data_socket: DataSocket


class NodeServices:
    """Sockets of the environments on one node, its data relay and its connection to the task set.

    An agent adds its own handlers to `handlers`. `welcomed` is called after each join; `families` returns the agent's
    own metrics.
    """

    def __init__(
        self,
        reactor: ReactorBase,
        settings: NodeSettings,
        welcomed: Callable[[], None],
        families: Callable[[], Sequence[Family]],
    ) -> None:
        self._reactor = reactor
        self._settings = settings
        self._master = settings.master
        self._tls = load_tls(settings.tls)
        self._data_relay = DataRelay(self._tls)
        self._served: dict[str, _Served] = {}  # by run
        self.handlers = Handlers()
        self.handlers.on(SetRelays, self._set_relays)
        self.handlers.do(SetRemovedMachines, self._refuse_removed)
        self.handlers.do(SetMaster, self._set_master)
        self.handlers.serve_metrics(ROLE, self._data_relay.families, families)
        hello = Hello(ROLE, settings.node, settings.token, __version__)

        def rejoined(_: Welcome) -> None:
            welcomed()

        self.link = ControlClient(reactor, settings.task_set, lambda: hello, self.handlers, rejoined, self._tls)
        self.fetcher = Fetcher(self.link, settings.master, settings.entry, self._tls)

    @property
    def served(self) -> set[str]:
        """Runs whose sockets are open."""
        return set(self._served)

    @property
    def relay(self) -> str:
        """HOST:PORT of the data relay."""
        return self._data_relay.address.removeprefix("relay:")

    async def listen(self, address: str) -> None:
        """Accept data links from other machines at an address of this node.

        Raises:
            OSError: The address cannot be used.
        """
        await self._data_relay.listen(address, self._settings.data_port)

    async def close(self) -> None:
        """Stop relaying data links."""
        await self._data_relay.close()

    async def serve(self, name: str, run: str, control: Path, socket: Path) -> None:
        """Open the sockets of an environment in its directory `control`; it accepts data links at `socket`.

        Raises:
            OSError: A socket cannot be created.
        """
        relay, data_socket = ControlRelay(self._reactor, self._master, self._tls), DataSocket(socket)
        await self._data_relay.add_environment(name, socket, control)
        self._served[run] = _Served(name, relay, data_socket)
        data_socket.offer(control)
        await relay.open(control)  # last, because an endpoint that has reached the Master may be dialled

    def stop_serving(self, run: str) -> None:
        """Close the sockets of an environment, if they are open."""
        served = self._served.pop(run, None)
        if served is None:
            return
        served.relay.close()
        served.data_socket.remove()
        if all(other.name != served.name for other in self._served.values()):  # a new run may have this name
            self._data_relay.remove_environment(served.name)

    async def notify(self, call: Call[Any]) -> None:
        """Make a call to the task set if it is joined; log an error. All is reported again after the next join."""
        try:
            await self.link.call(call, wait=0)
        except RceError as error:
            log.info("the task set did not take {call}: {error}", call=type(call).__name__, error=str(error))

    async def _set_relays(self, call: SetRelays) -> Nothing:
        self._data_relay.set_relays(call.relays)
        return Nothing()

    def _set_master(self, call: SetMaster) -> None:
        self._master = call.master
        for served in self._served.values():
            served.relay.lead(call.master)

    def _refuse_removed(self, call: SetRemovedMachines) -> None:
        if self._tls is not None:
            self._tls.set_removed(call.machines)
