"""Services of the platform's catalogue, as one robot uses them."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Self, TypeVar

from rce.client.actions import ActionClient
from rce.client.declarations import Declarations
from rce.client.dispatcher import Dispatcher
from rce.client.interface import Interface, Owner
from rce.client.services import ServiceClient
from rce.client.session import ClientSession
from rce.client.topics import Publisher, Subscriber
from rce.errors import AlreadyExists, NotFound, RceError, Unavailable
from rce.protocol.messages import LeaveService, UsedInterface, UsedService, UseService
from rce.spelling import unknown

I = TypeVar("I", bound=Interface)  # noqa: E741
KINDS: dict[str, Callable[[Owner, str, str], Interface]] = {
    "Subscriber": Publisher,
    "Publisher": lambda robot, tag, type_name: Subscriber(robot, tag, type_name, 0),
    "ServiceProvider": ServiceClient,
    "ActionProvider": ActionClient,
}
"""The robot's end of an interface; those of the protocol are named from the cloud's point of view."""


class Service:
    """Service of the catalogue that a robot uses; made by `Robot.service`.

    As an asynchronous context manager it leaves the service on exit. After a lost session the robot asks for it again.

    Attributes:
        name: `user/name`, or the name alone of a service that comes with RCE.
        tag: Begins the names of the robot's interfaces; name of the environment if the service is not shared.
        shared: The instance may serve other robots too, also those of other users.
        interfaces: The robot's interfaces by the names in the declaration of the service.
    """

    def __init__(
        self, robot: Owner, session: ClientSession, declarations: Declarations, dispatcher: Dispatcher
    ) -> None:
        """Prepare; `use` makes and connects the service."""
        self.name = self.tag = ""
        self.shared = False
        self.interfaces: dict[str, Interface] = {}
        self._robot = robot
        self._session = session
        self._declarations = declarations
        self._dispatcher = dispatcher

    @classmethod
    async def use(
        cls,
        robot: Owner,
        session: ClientSession,
        declarations: Declarations,
        dispatcher: Dispatcher,
        name: str,
        tag: str,
        raw: bool,
    ) -> Self:
        """Use a service; see `Robot.service`."""
        command = UseService(name, tag or name.rpartition("/")[2], raw)
        prefix = f"{command.containerTag}_"
        if command.containerTag in declarations.services:
            raise AlreadyExists(f"this robot uses a service as {command.containerTag} already: give another tag")
        service = cls(robot, session, declarations, dispatcher)
        dispatcher.expect(prefix)
        try:
            services = (await session.execute(command)).services
            if not services:
                raise Unavailable("this platform has no catalogue of services: it is older than this client")
            declarations.record(command)
            service._connect(services[0])
        finally:
            dispatcher.adopt(prefix, service.interfaces.values())
        return service

    def _connect(self, used: UsedService) -> None:
        self.name, self.tag, self.shared = used.service, used.containerTag, used.shared
        self.interfaces = {each.name: self._interface(each) for each in used.interfaces}

    def _interface(self, used: UsedInterface) -> Interface:
        kind = used.interfaceType.removesuffix("Converter").removesuffix("Forwarder")
        return KINDS[kind](self._robot, used.iTag, used.className)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.leave()

    async def leave(self) -> None:
        """Use the service no longer: its interfaces are removed; reads and calls that wait end at once.

        Raises:
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        for interface in self.interfaces.values():
            self._dispatcher.interfaces.pop(interface.tag, None)
            interface._end(None)
        command = LeaveService(self.tag)
        try:
            await self._session.execute(command)
        except RceError as error:
            if not isinstance(error, NotFound):
                raise
        self._declarations.record(command)

    def publisher(self, name: str) -> Publisher:
        """Return the publisher for a topic that the service takes; raises NotFound if it takes none of this name."""
        return self._find(name, Publisher)

    def subscriber(self, name: str) -> Subscriber:
        """Return the subscriber of a topic that the service gives; raises NotFound if it gives none of this name."""
        return self._find(name, Subscriber)

    def service_client(self, name: str) -> ServiceClient:
        """Return the client of a ROS service; raises NotFound if the service has none of this name."""
        return self._find(name, ServiceClient)

    def action_client(self, name: str) -> ActionClient:
        """Return the client of a ROS action; raises NotFound if the service has none of this name."""
        return self._find(name, ActionClient)

    def _find(self, name: str, kind: type[I]) -> I:
        found = self.interfaces.get(name)
        if not isinstance(found, kind):
            known = [each for each, interface in self.interfaces.items() if isinstance(interface, kind)]
            raise NotFound(f"{self.name}: {unknown(kind.__name__, name, known)}")
        return found
