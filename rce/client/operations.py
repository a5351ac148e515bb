"""Commands of a robot."""

from __future__ import annotations

import asyncio
from typing import Literal, TypedDict, Unpack

import msgspec

from rce.client.declarations import Declarations
from rce.client.session import ClientSession
from rce.errors import AlreadyExists, InvalidRequest, RceError
from rce.protocol.messages import (
    AddInterface,
    AddNode,
    AddRecorder,
    CodecName,
    Command,
    Connect,
    ContainerData,
    CreateContainer,
    DeleteParameter,
    Delivery,
    DestroyContainer,
    Disconnect,
    InterfaceType,
    NodeRestart,
    ParameterValue,
    Qos,
    Rates,
    RemoveInterface,
    RemoveNode,
    RemoveRecorder,
    SetParameter,
)
from rce.spelling import did_you_mean

Format = str
"""Form of messages: `png`, `jpeg` or `json` for images, `ros1` for raw messages, or a converter of the endpoint."""


class EnvironmentOptions(TypedDict, total=False):
    """Options of an environment. All are optional; what is left out is set by the limits of the user and the slots.

    docs/protocol.md has the details (`containerData`).

    Attributes:
        image: Container image to run, one of those that the user may use.
        size: Slots of a machine.
        cpu: Cores, also fractions.
        memory: Bytes, including files in `/tmp` and shared memory.
        pids: Processes and threads.
        disk: Bytes of the home directory.
        bandwidth: Bytes per second that the environment may send.
        io: Bytes per second that it may read from and write to its disk.
        gpus: Number of GPUs.
        special_features: Features that the machine must offer.
        env: Environment variables of the nodes.
        secrets: Secrets of the user (`rce secret set`), each with the variable that nodes get, or an empty string for
            a file only, in the directory `$RCE_SECRETS_DIR`.
        packages: The users' own packages to make available, each `name` or `user/name`, optionally with `@version`.
        group: Network group to join; groups are private to the user.
        group_ip: Address in the network group.
        restart: `always` (the default) starts an environment that dies again with all that it had.
    """

    image: str
    size: int
    cpu: float
    memory: int
    pids: int
    disk: int
    bandwidth: int
    io: Rates
    gpus: int
    special_features: list[str]
    env: dict[str, str]
    secrets: dict[str, str]
    packages: list[str]
    group: str
    group_ip: str
    restart: Literal["always", "no"]


class Operations:
    """Commands that a robot gives to the platform.

    Each command waits until the platform has executed it. While the robot is offline, a command waits for the next
    connection; one whose answer was lost is repeated, and counts as successful if the first attempt was executed.

    All commands raise:

    - `TimedOut` if there is no answer within the robot's `timeout`. The command may have been executed.
    - `Unavailable` if the robot has not been opened or has been closed.
    - Otherwise the error with which the platform answers, for example `NotFound`, `AlreadyExists`, `InvalidRequest`,
      `LimitExceeded` or `Forbidden`.

    With a server of the original, a command returns once it has been sent, and its error arrives in `Robot.events()`.
    """

    def __init__(self, session: ClientSession, declarations: Declarations) -> None:
        self._session = session
        self._declarations = declarations

    async def create_environment(
        self, tag: str, *, exist_ok: bool = False, **options: Unpack[EnvironmentOptions]
    ) -> None:
        """Start an environment.

        Args:
            tag: Name of the environment, unique among those of the user.
            exist_ok: Accept an environment of that name that exists already, whatever its options.
            **options: See `EnvironmentOptions`.

        Raises:
            AlreadyExists: The name is in use and `exist_ok` is false, or a robot has it.
            InvalidRequest: An option is wrong.
            LimitExceeded: The user may not have that much.
            NoCapacity: No machine has room for it.
            StartFailed: The environment did not start.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        try:
            await self.configure(CreateContainer(tag, _container_data(options)))
        except AlreadyExists as error:
            if not exist_ok or error.info.fields.get("kind") == "robot":
                raise

    async def destroy_environment(self, tag: str) -> None:
        """Stop an environment and remove its nodes, parameters, interfaces and connections.

        Args:
            tag: Name of the environment.

        Raises:
            NotFound: There is no such environment.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.configure(DestroyContainer(tag))

    async def add_node(
        self,
        environment: str,
        tag: str,
        pkg: str,
        exe: str = "",
        *,
        args: str = "",
        name: str = "",
        namespace: str = "",
        exist_ok: bool = False,
        restart: NodeRestart = "",
        launch: str = "",
    ) -> None:
        """Start a ROS 2 node in an environment.

        Args:
            environment: Name of the environment.
            tag: Name by which the platform knows the node, unique within the environment.
            pkg: ROS package.
            exe: Executable of the package.
            args: Command line arguments. `$(find PKG)` and `$(env VAR)` are substituted.
            name: ROS name of the node in place of the one in its code.
            namespace: ROS namespace of the node.
            exist_ok: Keep a node with this tag that was started in the same way, and replace one that was not.
            restart: When to start it again after it ended by itself: `on-failure`, `always` or `no`, with pauses that
                grow to 30 s. Empty: after a failure, if it ran for 5 s and the environment has not `restart="no"`.
            launch: Launch file of the package, in place of `exe`; its arguments are `args`, as `NAME:=VALUE`. Its nodes
                get the tags `TAG.NAME`, and start and end together.

        Raises:
            NotFound: The environment does not exist.
            AlreadyExists: The environment has a node with this tag, and `exist_ok` is false.
            StartFailed: The node did not start, for example because the package or executable does not exist.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.configure(AddNode(environment, tag, pkg, exe, args, name, namespace, exist_ok, restart, launch))

    async def remove_node(self, environment: str, tag: str) -> None:
        """Stop a node.

        Args:
            environment: Name of the environment.
            tag: Name of the node, as given to `add_node`.

        Raises:
            NotFound: The environment or the node does not exist.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.configure(RemoveNode(environment, tag))

    async def set_parameter(self, environment: str, name: str, value: ParameterValue, *, node: str = "") -> None:
        """Set a ROS 2 parameter.

        Args:
            environment: Name of the environment.
            name: Name of the parameter.
            value: A bool, number, string or a list of one of these.
            node: Tag of the only node that gets the parameter. Without it, all nodes that are started later get it,
                and so do running ones that have declared it.

        Raises:
            NotFound: The environment or the node does not exist.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.configure(SetParameter(environment, name, value, node))

    async def delete_parameter(self, environment: str, name: str, *, node: str = "") -> None:
        """Remove a parameter that was set with `set_parameter`; nodes that are started later do not get it.

        Args:
            environment: Name of the environment.
            name: Name of the parameter.
            node: Tag of the node for which it was set, if it was set for one only.

        Raises:
            NotFound: The environment, node or parameter does not exist.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.configure(DeleteParameter(environment, name, node))

    async def add_recorder(
        self,
        environment: str,
        tag: str,
        *topics: str,
        max_size: int = 0,
        max_duration: float = 0.0,
        exist_ok: bool = False,
    ) -> None:
        """Record topics of an environment on its machine, until the recorder or the environment is removed.

        It is started again with the environment, which begins another file. A recorder that ends by itself, because a
        quota is used up, for example, sends a `RecorderEvent`.

        Args:
            environment: Name of the environment.
            tag: Name of the recorder, unique within the environment.
            *topics: Topics to record, also before they exist; without any, all that are not hidden.
            max_size: Bytes of a file after which the next one begins; 0 is no limit.
            max_duration: Seconds of a file after which the next one begins; 0 is no limit.
            exist_ok: Keep a recorder of this tag that is the same, and replace one that is not.

        Raises:
            NotFound: The environment does not exist.
            AlreadyExists: The environment has a recorder with this tag.
            LimitExceeded: The quota for recordings is used up.
            StartFailed: The machine of the environment keeps no recordings.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.configure(AddRecorder(environment, tag, list(topics), max_size, max_duration, exist_ok))

    async def remove_recorder(self, environment: str, tag: str) -> None:
        """End a recorder, and complete its file. Its recordings are kept.

        Args:
            environment: Name of the environment.
            tag: Name of the recorder.

        Raises:
            NotFound: There is no such recorder.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.configure(RemoveRecorder(environment, tag))

    async def add_interface(
        self,
        endpoint: str,
        tag: str,
        interface_type: InterfaceType,
        type_name: str,
        *,
        addr: str = "",
        qos: Qos | None = None,
        format: Format = "png",
        delivery: Delivery | None = None,
        codec: CodecName = "",
    ) -> None:
        """Add an interface to an environment or a robot.

        For the robot's own interfaces use `Robot.publisher` and its siblings; for those of an environment
        `Environment.publisher` and its siblings add both ends and connect them.

        Args:
            endpoint: Name of the environment or the robotID.
            tag: Name of the interface, unique within the endpoint.
            interface_type: `PublisherInterface`, `SubscriberInterface`, `ServiceClientInterface` or
                `ServiceProviderInterface` in an environment; the same with `Converter` or `Forwarder` for a robot.
            type_name: ROS message or service type.
            addr: ROS topic or service name, for environments only.
            qos: ROS 2 quality of service.
            format: Encoding in which a robot gets images.
            delivery: Priority, greatest age and rate of messages between a robot and the platform, for topics of
                robots.
            codec: Codec of the packets in which a robot exchanges images and clouds.

        Raises:
            NotFound: The endpoint does not exist.
            AlreadyExists: The endpoint has an interface with this tag.
            UnknownType: The platform does not know the type.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        options = (addr, qos or Qos(), format, delivery or Delivery(), codec)
        await self.configure(AddInterface(endpoint, tag, interface_type, type_name, *options))

    async def remove_interface(self, endpoint: str, tag: str) -> None:
        """Remove an interface and its connections.

        Args:
            endpoint: Name of the environment or the robotID.
            tag: Name of the interface.

        Raises:
            NotFound: There is no such interface.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.configure(RemoveInterface(endpoint, tag))

    async def connect(self, a: str, b: str) -> None:
        """Connect two interfaces, so that messages pass from one to the other.

        Args:
            a: One interface as `endpoint/interface`, for example `brain/scan`.
            b: The other one; the order does not matter.

        Raises:
            NotFound: One of the interfaces does not exist.
            NotConnectable: Their kinds are not opposites or their types differ.
            AlreadyExists: They are connected already.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.configure(Connect(a, b))

    async def disconnect(self, a: str, b: str) -> None:
        """Remove the connection between two interfaces.

        Args:
            a: One interface as `endpoint/interface`.
            b: The other one; the order does not matter.

        Raises:
            NotFound: There is no such connection.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.configure(Disconnect(a, b))

    async def configure(self, *commands: Command) -> None:
        """Execute several commands in their order, without waiting for one before the next is sent.

        A failed command does not stop the others.

        Args:
            *commands: Commands of `rce.protocol.messages`, such as `AddInterface` and `Connect`.

        Raises:
            RceError: The first error after all commands have ended; its `item` (`commands[2]`) names the command if
                there are several. `TimedOut` if the platform did not answer within the robot's `timeout`,
                `Unavailable` if the robot is not open.
        """
        outcomes = await asyncio.gather(*map(self._session.execute, commands), return_exceptions=True)
        failed: list[BaseException] = []
        for index, (command, outcome) in enumerate(zip(commands, outcomes, strict=True)):
            if isinstance(outcome, AlreadyExists):
                self._declarations.record_existing(command)
            if not isinstance(outcome, BaseException):
                self._declarations.record(command)
            else:
                several = len(commands) > 1
                failed.append(
                    outcome.with_item(f"commands[{index}]") if several and isinstance(outcome, RceError) else outcome
                )
        if failed:
            raise failed[0]


def _container_data(options: EnvironmentOptions) -> ContainerData:
    names = {"special_features": "specialFeatures", "group_ip": "groupIP"}
    unknown = options.keys() - EnvironmentOptions.__annotations__.keys()
    if unknown:
        name = min(unknown)
        names = EnvironmentOptions.__annotations__
        known = did_you_mean(name, names) or f"there are {', '.join(names)}"
        raise InvalidRequest(f"options of the environment: there is no {name}: {known}", field=name)
    try:
        return msgspec.convert({names.get(name, name): value for name, value in options.items()}, ContainerData)
    except msgspec.ValidationError as error:
        raise InvalidRequest(f"options of the environment: {error}") from None
