"""The control calls between the processes: what each may ask of which, with its arguments and its result.

Sets of names cross, never counters, and every call may be made twice: what is there already stays as it is. After each
(re)connection a process says what it really has (`Join.report`), and the Master answers with what is wanted (`Sync`).
Times are seconds, sizes bytes.
"""

from __future__ import annotations

from typing import Generic, Literal, TypeVar, get_args

import msgspec
from msgspec import Raw, Struct

from rce.errors import ErrorInfo, InvalidRequest
from rce.messages import Command, ContainerData, ParameterValue, Qos, StatusData
from rce.metrics import Family

R = TypeVar("R")
_commands: dict[str, type[Command]] = {kind.__name__: kind for kind in get_args(Command)}


class Call(Struct, Generic[R], frozen=True):
    """A question from one process to another; `R` is the type of the answer."""


def result_type(call: type[Call[R]]) -> type[R]:
    """The type that the answer to `call` has."""
    kind: type[R] = get_args(call.__orig_bases__[0])[0]  # type: ignore[attr-defined]  # every generic subclass has it
    return kind


class Nothing(Struct, frozen=True):
    """The answer of calls that only do something."""


class Settled(Struct, frozen=True):
    """The answer of calls about several things by name: what went wrong, nothing said of what is well."""

    failed: dict[str, ErrorInfo] = {}


# --- what exists in endpoints -----------------------------------------------------------------------------------------


class InterfaceSpec(Struct, frozen=True):
    """An interface as an endpoint sees it.

    `id` (32 hex) names it in data frames; `owner` is the robot or environment, as `userID/tag`.
    """

    id: str
    owner: str
    tag: str
    kind: str  # e.g. PublisherConverter
    type: str  # className, in the spelling given at addInterfaces
    addr: str = ""
    qos: Qos = Qos()
    format: str = "png"


class Route(Struct, frozen=True):
    """`interface` of this endpoint exchanges messages with the remote interface `peer` over `link`."""

    interface: str
    peer: str
    link: str


class LinkSpec(Struct, frozen=True):
    """A data link to another endpoint. The side with `dial` connects to the first address that answers."""

    name: str
    key: str  # 32 hex, known to both ends, good for one opening
    dial: list[str] = []  # unix:/PATH, tcp:HOST:PORT, relay:HOST:PORT/user/tag; empty: wait for the other side
    rate: int = 0  # bytes a second that are taken from `sender`, over all links together; 0: no limit
    sender: str = ""


class NodeSpec(Struct, frozen=True):
    """A ROS 2 node that runs in an environment."""

    tag: str
    pkg: str
    exe: str
    args: str = ""
    name: str = ""
    namespace: str = ""


class ParameterSpec(Struct, frozen=True):
    """A ROS 2 parameter: of every node of the environment, or of one node."""

    name: str
    value: ParameterValue
    node: str = ""

    @property
    def key(self) -> str:
        return f"{self.node}:{self.name}"


# --- Master to endpoints ----------------------------------------------------------------------------------------------


class Sync(Call[Settled], frozen=True):
    """All that this endpoint shall have: it removes what is not named here and makes what it lacks.

    Failures are keyed by interface id, `node:TAG`, `parameter:KEY`, `link:NAME`.
    """

    interfaces: list[InterfaceSpec] = []
    links: list[LinkSpec] = []
    routes: list[Route] = []
    nodes: list[NodeSpec] = []
    parameters: list[ParameterSpec] = []
    robots: list[str] = []  # userID/robotID of those with a session here


class Bind(Call[Nothing], frozen=True):
    """Make an interface."""

    interface: InterfaceSpec


class Unbind(Call[Nothing], frozen=True):
    """Remove an interface and its routes."""

    interface: str


class OpenLink(Call[Nothing], frozen=True):
    """Open a data link, or expect the other side to; answered when the spec is taken, not when the link is up."""

    link: LinkSpec


class CloseLink(Call[Nothing], frozen=True):
    """Close a data link."""

    link: str


class AddRoute(Call[Nothing], frozen=True):
    """Let a pair of interfaces exchange messages; the first route of an interface starts it."""

    route: Route


class RemoveRoute(Call[Nothing], frozen=True):
    """Part a pair of interfaces; losing its last route stops an interface."""

    interface: str
    peer: str


class StartNode(Call[Nothing], frozen=True):
    """Start a node; answered when the process runs. StartFailed, NotFound (package, executable)."""

    node: NodeSpec


class StopNode(Call[Nothing], frozen=True):
    """Stop a node: SIGINT, then SIGTERM, then SIGKILL; answered when its process group is gone."""

    node: str


class PutParameter(Call[Nothing], frozen=True):
    """Set a parameter for later nodes, and live where a running node declares it."""

    parameter: ParameterSpec


class DropParameter(Call[Nothing], frozen=True):
    """Forget a parameter."""

    key: str


class Log(Struct, frozen=True):
    """Lines of a node's or an environment's output. What comes later is asked for with `after=next`."""

    lines: list[str]
    next: str = ""


class ReadLog(Call[Log], frozen=True):
    """A node's output, or that of the environment itself if `node` is empty: the last lines, at most so many.

    With `after`, the `next` of an earlier answer: what has come since, in part if it is much; with `wait` answered only
    once there is something, or after so many seconds. A node that was started anew begins anew. NotFound.
    """

    node: str
    lines: int = 100
    after: str = ""
    wait: float = 0


class RosName(Struct, frozen=True):
    """A topic or service of ROS in an environment, with its types; of a topic, how many nodes publish and subscribe."""

    name: str
    types: list[str]
    publishers: int = 0
    subscribers: int = 0


class RosGraph(Struct, frozen=True):
    """What ROS has in an environment now, in the order of the names."""

    topics: list[RosName]
    services: list[RosName]


class ReadGraph(Call[RosGraph], frozen=True):
    """The topics and services of an environment."""


class Counts(Struct, frozen=True):
    """Messages and bytes of payload since the interface was made, or since two interfaces were routed to each other."""

    messages: int = 0
    bytes: int = 0
    drops: int = 0  # messages that were dropped


class InterfaceTraffic(Struct, frozen=True):
    """What has passed an interface. `sent` counts a message once, however many peers it goes to, and has all drops.

    Of each peer, by its id: what came from it, and the drops of that and of what was on the way to it.
    """

    sent: Counts
    received: Counts
    peers: dict[str, Counts] = {}


class Traffic(Struct, frozen=True):
    """By the id of the interface."""

    interfaces: dict[str, InterfaceTraffic]


class CountTraffic(Call[Traffic], frozen=True):
    """What has passed the interfaces of this endpoint."""


Hop = Literal["entered", "sent", "received", "delivered"]
"""Of a message at an endpoint: it came from the robot or ROS; begins to go out over a link; came in; went to robot or
ROS."""


class Passage(Struct, frozen=True):
    """A message at a hop, seconds since 1970 by the clock of the machine. Its id is unique for `source` only.

    `source` is the interface that it comes from; of an answer, the one that asked, so that both are joined.
    """

    source: str
    message: str
    interface: str
    hop: Hop
    time: float


class Passages(Struct, frozen=True):
    """In the order in which they were noted."""

    passages: list[Passage]


class FollowMessages(Call[Passages], frozen=True):
    """Note the hops of all messages of these interfaces, for so many seconds from now; answers what was noted before.

    Whoever follows makes up a name for it, and asks again and again.
    """

    trace: str
    interfaces: list[str]
    seconds: float = 5.0


class Metrics(Struct, frozen=True):
    """What a process counts of itself."""

    families: list[Family]


class ReadMetrics(Call[Metrics], frozen=True):
    """The metrics of this process."""


class Tell(Call[Nothing], frozen=True):
    """Send a status to a robot (Robot endpoint only); `error` goes as an ER."""

    robot: str
    status: StatusData | None = None
    error: ErrorInfo | None = None


class DropRobot(Call[Nothing], frozen=True):
    """End a robot's session and close its socket with the reason."""

    robot: str
    reason: str


# --- Master to task sets ----------------------------------------------------------------------------------------------


class Group(Struct, frozen=True):
    """The network group of an environment. `name` is `userID/group`; `members` are addresses by containerTag."""

    name: str
    subnet: str  # as 10.128.0.0/24; no other group of the platform has it
    address: str  # of the environment, in the subnet
    members: dict[str, str] = {}  # all of now, this one too; others may come later


Egress = Literal["none", "internet", "all"]
"""What of the network an environment reaches besides its group: nothing; the internet without private and link-local
networks, metadata of clouds, and its host; or all of it."""


class EnvironmentSpec(Struct, frozen=True):
    """An environment to run. `name` is `userID/containerTag`; `run` (32 hex) tells its lives apart."""

    name: str
    run: str
    token: str  # one-time join token of its Environment endpoint
    options: ContainerData
    group: Group | None = None
    packages: list[str] = []  # digests of the users' packages that it sees, first come first found
    egress: Egress = "none"


class StartEnvironment(Call[Nothing], frozen=True):
    """Start an environment; answered when its process or container runs. Its endpoint joins the Master by itself."""

    environment: EnvironmentSpec


class StopEnvironment(Call[Nothing], frozen=True):
    """Stop an environment and remove all that it left; answered when nothing of it remains."""

    name: str


class KeepEnvironments(Call[Nothing], frozen=True):
    """Stop and remove every environment whose run is not among these."""

    runs: list[str]


class KnowRelays(Call[Nothing], frozen=True):
    """The data relays of all machines, HOST:PORT: to these, and no others, environments here may be taken."""

    relays: list[str]


class Used(Struct, frozen=True):
    """What an environment has used since it began: processor time in seconds; and has now: memory in bytes."""

    seconds: float
    memory: int


class Usage(Struct, frozen=True):
    """By the name of the environment; those of which nothing is known at present are left out."""

    environments: dict[str, Used]


class MeasureUsage(Call[Usage], frozen=True):
    """What the environments of this task set, or those on the node of this agent, use."""


# --- between a task set and its agents, one on each node of a swarm ---------------------------------------------------


class NodeReport(Call[Nothing], frozen=True):
    """What is on an agent's node: said after each join and when it changes."""

    runs: list[str]  # of the environments that run there with all that they need
    images: dict[str, str]  # id by tag, of those for this version
    protected: bool  # whether its Docker gives containers no new privileges
    relay: str  # where data links to environments there are taken, HOST:PORT


class ContainerEnded(Call[Nothing], frozen=True):
    """The container of an environment has ended, whoever ended it."""

    run: str
    reason: str
    status: int
    lines: list[str]


class Unfit(Call[Nothing], frozen=True):
    """An environment lacks what it asked for on the node where it was placed, and so does nothing there."""

    run: str
    error: ErrorInfo


class HaveImage(Call[Nothing], frozen=True):
    """Have the node's Docker take an image from the task set, and call it so; answered when it has. StartFailed."""

    tag: str
    source: str  # REPOSITORY@DIGEST
    user: str
    secret: str


class KnowGroup(Call[Nothing], frozen=True):
    """The members of a network group, `userID/group`: addresses by containerTag."""

    name: str
    members: dict[str, str]


class Cleared(Struct, frozen=True):
    """Nothing of an environment is there any more; `found` if there was a container of it."""

    found: bool


class ClearRun(Call[Cleared], frozen=True):
    """Stop the container of an environment and remove all that it left; answered when nothing of it is there."""

    run: str


class ForgetProofs(Call[Nothing], frozen=True):
    """To a service: what this user has proved to it may not hold any more, and is to be proved again."""

    user: str


# --- to the Master ----------------------------------------------------------------------------------------------------


class Hello(Struct, frozen=True):
    """First words of every process to the Master.

    `token` is a one-time join token, or the credential that the Master gave in exchange for one.
    """

    role: str  # robot | container | environment | service; agent, to its task set
    name: str
    token: str
    version: str
    incarnation: str = ""  # made at the process's start: tells a restarted process from the one before
    host: str = ""  # identity of the machine: endpoints on one host link over UNIX sockets
    addresses: list[str] = []  # where others reach its data port (unix:, tcp:); task set: its machine's relay (relay:)
    url: str = ""  # Robot endpoint, service: where they are reached (ws://host:port/); an empty host is the request's
    capacity: int = 0  # task set: slots
    features: list[str] = []  # task set: special features of the machine
    gpus: int = 0  # task set: graphics processors of the machine
    robots: list[str] = []  # Robot endpoint: those with a session, connected or in their grace time
    environments: dict[str, str] = {}  # task set: run of each environment that really runs, by name


class Welcome(Struct, frozen=True):
    """The Master's answer: the credential for later (re)connections."""

    credential: str


class LoggedIn(Struct, frozen=True):
    """The session; what a resumed one has is bound and routed by the time of this answer. `token` resumes it."""

    token: str
    resumed: bool


class Login(Call[LoggedIn], frozen=True):
    """A robot asks for a session at this Robot endpoint. Unauthorized, InvalidName, AlreadyExists (robotID in use)."""

    user: str
    robot: str
    secret: str  # API key, or SHA-256 hex of the password
    resume: str = ""  # token of the session to take over
    features: list[str] = []
    address: str = ""


class Person(Struct, frozen=True):
    """Who has proved to be a user, by an API key with this id or by a password."""

    user: str
    role: str
    key: str = ""


class Vouch(Call[Person], frozen=True):
    """A service asks who its client is, and whether they may. With an API key the user may be left out.

    Unauthorized, TooManyAttempts, Forbidden.
    """

    user: str
    secret: str  # API key, or SHA-256 hex of the password
    operation: str = "job.submit"  # or job.read
    address: str = ""  # of the client


class NoteDone(Call[Nothing], frozen=True):
    """A service tells what a client did with what it keeps for them, or could not do: for the audit log."""

    person: Person
    action: str  # as job.cancel
    object: str  # as user/ID
    result: str  # ok, or the code of the error
    address: str = ""  # of the client


class Grant(Struct, frozen=True):
    """The right of one service to act for one user, by name: the name alone opens nothing."""

    grant: str


class Delegate(Call[Grant], frozen=True):
    """A service asks to act for a client later: until it says `EndGrant`, or the user or the API key is gone."""

    user: str
    secret: str
    address: str = ""


class LentKey(Struct, frozen=True):
    """A key with which the service connects as a robot of this user."""

    user: str
    key: str


class Borrow(Call[LentKey], frozen=True):
    """The service that holds a grant takes a new key for it; the one before is void. Unauthorized."""

    grant: str
    seconds: float  # until it expires


class EndGrant(Call[Nothing], frozen=True):
    """The grant and its key are void from now on."""

    grant: str


class Leave(Call[Nothing], frozen=True):
    """A robot's grace time is over: its interfaces and connections go."""

    robot: str


class Execute(Call[Nothing], frozen=True):
    """A robot's command; answered on completion, or with its error.

    `again` marks one that was under way when the Master was lost: what it made already is then not an error.
    """

    robot: str
    kind: str
    item: Raw
    again: bool = False

    @staticmethod
    def of(robot: str, command: Command, again: bool = False) -> Execute:
        """The call for a command. Its kind stands beside it: commands on the robots' wire have no tag of their own."""
        return Execute(robot, type(command).__name__, Raw(msgspec.msgpack.encode(command)), again)

    @property
    def command(self) -> Command:
        """Raises InvalidRequest."""
        if self.kind not in _commands:
            raise InvalidRequest(f"{self.kind[:80]!r} is not a command")
        try:
            return msgspec.msgpack.decode(self.item, type=_commands[self.kind])
        except msgspec.DecodeError as error:
            raise InvalidRequest(f"{self.kind}: {error}") from None


class Definitions(Struct, frozen=True):
    """Type definitions, text of `.msg` and `.srv` files by `pkg/msg/Name` and `pkg/srv/Name`, dependencies included."""

    texts: dict[str, str]


class Describe(Call[Definitions], frozen=True):
    """The definition of a type: a Robot endpoint asks the Master, the Master that user's environments. UnknownType."""

    user: str
    type: str
    service: bool


class NodeDied(Call[Nothing], frozen=True):
    """A node of this environment ended by itself, `seconds` after its start."""

    node: str
    status: int
    lines: list[str]
    seconds: float = 0


class LinkLost(Call[Nothing], frozen=True):
    """A data link broke or did not open; the Master gives both ends a new key."""

    link: str
    reason: str


class EnvironmentDied(Call[Nothing], frozen=True):
    """An environment of this task set ended by itself or did not come up."""

    name: str
    run: str
    reason: str


class Ticket(Struct, frozen=True):
    """What an archive is fetched with, once and soon: `path` at the Master's entry, with the token as bearer's.

    `scheme` and `port` are those of the entry, whose host is where the Master is.
    """

    scheme: str
    port: int
    path: str
    token: str
    size: int


class FetchPackage(Call[Ticket], frozen=True):
    """A task set, or its agent, lacks an archive that an environment of its own needs. NotFound."""

    digest: str


class LimitReached(Call[Nothing], frozen=True):
    """An environment of this task set runs on, but a limit took something of it."""

    name: str
    run: str
    reason: str


class Report(Call[Nothing], frozen=True):
    """Something that the owner of an interface should know: a failure (its message) or drops."""

    owner: str
    interface: str
    error: ErrorInfo | None = None
    drops: int = 0


class Ping(Call[Nothing], frozen=True):
    """Are you there?"""
