"""Settings of an Environment endpoint."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

# MB. Fast DDS fills its segment when a process joins, which takes 1 ms for each; a larger one made messages of 10 MB no
# faster.
SEGMENT = 32


class Settings(Struct, frozen=True):
    """Settings of an Environment endpoint, which speaks ROS 2 for robots and runs the nodes of one environment.

    The engine that starts the endpoint sets the ROS domain and the discovery range by the variables of ROS 2.
    """

    name: Annotated[str, Meta(description="userID/containerTag", pattern="^[^/]+/[^/]+$")]
    run: Annotated[str, Meta(description="32 hex digits that identify this run of the environment")]
    token: Annotated[str, Meta(description="one-time join token; better given as RCE_TOKEN, which stays private")]
    master: Annotated[str, Meta(description="Twisted client endpoint of the Master, e.g. tcp:127.0.0.1:8080")]
    data_dir: Annotated[Path, Meta(description="directory for logs, sockets and the home directory of nodes")]
    host: Annotated[str, Meta(description="identity of the machine; needed in a container, which hides it")] = ""
    socket: Annotated[
        Path | None, Meta(description="UNIX socket for data links; its path must be the same for dialling endpoints")
    ] = None
    listener: Annotated[
        Path | None,
        Meta(
            description="UNIX socket at which the endpoint receives `socket`, already bound; empty: it makes it itself"
        ),
    ] = None
    relay: Annotated[
        Path | None, Meta(description="UNIX socket through which data links reach other machines; empty: the network")
    ] = None
    recordings: Annotated[
        Path | None, Meta(description="UNIX socket of the machine's store of recordings; empty: it has none")
    ] = None
    address: Annotated[
        str,
        Meta(description="address of this environment in its network group; empty: it is in none"),
    ] = ""
    peers: Annotated[list[str], Meta(description="addresses of the group's members, comma-separated")] = []
    tls: Annotated[
        Path | None, Meta(description="directory with ca.pem, cert.pem and key.pem, for TLS between machines")
    ] = None
    package_path: Annotated[
        list[Path], Meta(description="directories of packages with nodes: prefixes of ROS 2, or sources")
    ] = []
    typesupport: Annotated[list[Path], Meta(description="prefixes with type support that provisioning has built")] = []
    env: Annotated[str, Meta(description="JSON object with the user's variables for nodes")] = "{}"
    shared_memory: Annotated[
        int, Meta(description="MB of the shared memory segment of Fast DDS in each process", ge=1, le=4096)
    ] = SEGMENT
