"""Handshake in which a process joins the Master, or an agent its task set."""

from __future__ import annotations

from msgspec import Struct


class Hello(Struct, frozen=True):
    """First message of each process to the Master.

    `token` is a one-time join token, or the credential that the Master issued in exchange for one.
    """

    role: str  # robot | container | environment | service; agent, to its task set
    name: str
    token: str
    version: str
    incarnation: str = ""  # random, made at the start of the process: distinguishes it from earlier starts
    host: str = ""  # identity of the machine: endpoints on one host link over UNIX sockets
    addresses: list[str] = []  # of its data port (unix:, tcp:); task set: of its machine's relay (relay:)
    url: str = ""  # Robot endpoint, service: URL for clients (ws://host:port/); an empty host means that of the request
    capacity: int = 0  # task set: slots
    features: list[str] = []  # task set: special features of the machine
    gpus: int = 0  # task set: graphics processors of the machine
    robots: list[str] = []  # Robot endpoint: those with a session, connected or in their grace period
    environments: dict[str, str] = {}  # task set: run of each environment that is actually running, by name
    away: list[str] = []  # Robot endpoint: those of `robots` in their grace period


class Welcome(Struct, frozen=True):
    """Answer of the Master, with the credential for later connections."""

    credential: str
