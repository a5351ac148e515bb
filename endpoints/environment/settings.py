"""Settings of an Environment endpoint."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct


class Settings(Struct, frozen=True):
    """The Environment endpoint of RCE: speaks ROS 2 for the robots of one environment, and starts its nodes.

    The engine that starts it sets the ROS domain and the range of discovery by ROS 2's own variables.
    """

    name: Annotated[str, Meta(description="userID/containerTag", pattern="^[^/]+/[^/]+$")]
    run: Annotated[str, Meta(description="32 hex digits that tell this life of the environment from others")]
    token: Annotated[str, Meta(description="one-time join token; better given as RCE_TOKEN, which nobody else sees")]
    master: Annotated[str, Meta(description="Twisted client endpoint of the Master, e.g. tcp:127.0.0.1:8080")]
    data_dir: Annotated[Path, Meta(description="directory for logs, sockets and the nodes' home")]
    listen: Annotated[str, Meta(description="address for data links over TCP; empty: only dial and UNIX socket")] = ""
    host: Annotated[str, Meta(description="identity of the machine, where a container hides it")] = ""
    socket: Annotated[
        Path | None, Meta(description="UNIX socket for data links, a path that is the same for who dials it")
    ] = None
    relay: Annotated[
        Path | None, Meta(description="UNIX socket by which data links reach other machines; empty: the network")
    ] = None
    address: Annotated[
        str,
        Meta(description="of this environment in its network group, if it is in one"),
    ] = ""
    peers: Annotated[list[str], Meta(description="addresses of the group's members, comma-separated")] = []
    tls: Annotated[
        Path | None, Meta(description="directory with ca.pem, cert.pem and key.pem, for TLS between machines")
    ] = None
    package_path: Annotated[
        list[Path], Meta(description="directories of packages with nodes: prefixes of ROS 2, or sources")
    ] = []
    typesupport: Annotated[list[Path], Meta(description="prefixes that provisioning has built type support in")] = []
    env: Annotated[str, Meta(description="JSON object of the user's variables for nodes")] = "{}"
    shared_memory: Annotated[
        int, Meta(description="MB of Fast DDS's shared-memory segment, of each process", ge=1, le=4096)
    ] = 64
