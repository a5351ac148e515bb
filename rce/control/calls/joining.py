"""Handshake in which a process joins the Master, or an agent its task set."""

from __future__ import annotations

from msgspec import Struct

from rce.control.calls.call import Call, Nothing


class Hello(Struct, frozen=True):
    """First message of each process to the Master.

    Of an environment's Hello the Master uses the token, and the host if its task set has several: programs in an
    environment may send one, and what others dial must not be their choice.

    `token` is a one-time join token, or the credential of the process. With a join token the process sends the
    `credential` by which it will join from then on. It has made and stored that before, so that nothing is lost with
    the answer of the Master: the process sends the same Hello again.
    """

    role: str  # robot | container | environment | service; agent, to its task set
    name: str
    token: str
    version: str
    incarnation: str = ""  # random, made at the start of the process: distinguishes it from earlier starts
    host: str = ""  # identity of the machine: endpoints on one host link over UNIX sockets. Task set: empty if several
    addresses: list[str] = []  # Robot endpoint: of its data port (unix:, tcp:)
    url: str = ""  # Robot endpoint, service: URL for clients (ws://host:port/); an empty host means that of the request
    capacity: int = 0  # task set: slots
    features: list[str] = []  # task set: special features of the machine
    gpus: int = 0  # task set: graphics processors of the machine
    not_enforced: list[str] = []  # task set: options of environments that have no effect there
    robots: list[str] = []  # Robot endpoint: those with a session, connected or in their grace period
    environments: dict[str, str] = {}  # task set: run of each environment that is actually running, by name
    away: list[str] = []  # Robot endpoint: those of `robots` in their grace period
    sockets: str = ""  # task set: path of an environment's socket for data links, with {name}, {user} and {run}
    relays: dict[str, str] = {}  # task set: HOST:PORT of the data relay on each of its hosts
    credential: str = ""  # at least 32 random characters; empty: the Master makes one
    term: int = 0  # the latest term of a Master that the process knows


class SetRemovedMachines(Call[Nothing], frozen=True):
    """Set when machines were removed, in seconds since 1970: their certificates from before are refused."""

    machines: dict[str, float]


class SetRemovedUsers(Call[Nothing], frozen=True):
    """Set when users were removed, by the Master's clock: a process removes what it keeps of them, once.

    A later user of the same name must not inherit it.
    """

    users: dict[str, float]


class JoinToken(Struct, frozen=True):
    """One-time join token of the process of this name."""

    name: str
    token: str


class InviteSibling(Call[JoinToken], frozen=True):
    """Ask the Master for a join token for a further process of this Robot endpoint, of which there is one by number."""

    number: int


class Welcome(Struct, frozen=True):
    """Answer of the Master, with the credential of the process and the term of the Master."""

    credential: str
    term: int = 0
