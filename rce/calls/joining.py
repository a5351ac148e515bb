"""How a process joins the Master, or an agent its task set."""

from __future__ import annotations

from msgspec import Struct


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
    away: list[str] = []  # Robot endpoint: those of `robots` in their grace time


class Welcome(Struct, frozen=True):
    """The Master's answer: the credential for later (re)connections."""

    credential: str
