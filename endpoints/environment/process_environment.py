"""Process environment of the endpoint and its nodes: variables, the Fast DDS profile, and settings of malloc."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from endpoints.environment.lazy_import import import_lazily
from endpoints.environment.settings import Settings
from rce.api.knowledge_requests import SOCKET
from rce.process import malloc
from rce.process.malloc import MB

ADDRESS = "RCE_GROUP_IP"  # address of the environment in its network group
KNOWLEDGE = "knowledge.sock"  # in the directory of the environment
MARKER = "RCE_RUN"  # variable by which engines find processes that a killed endpoint has left behind
NODE_PATH = Path(__file__).with_name("nodepath")
# A subscription misses the first messages of a publisher that it has just discovered, and large ones while the shared
# memory segment is full. They are sent again after the next heartbeat, which by default comes only every 3 s.
HEARTBEAT = 20_000_000  # ns
# Within one host shared memory is enough, and the loopback interface where Fast DDS does not recognise that two
# processes are on one host: it compares the addresses that the hosts had when the processes began. With LOCALHOST, rmw
# adds transports of its own to those of the profile, and nodes take up to 3 s to find each other instead of 0.1 s.
# Processes find each other by announcements: every 20 ms in the first two seconds of a process, later every 200 ms. One
# of ten nodes that start beside an older endpoint needs the next announcement of that; by default it would come after
# 3 s. An idle process with two others spends 0.2 % of a core on them.
RANGE, NO_NETWORK = "ROS_AUTOMATIC_DISCOVERY_RANGE", "SYSTEM_DEFAULT"
# Nodes are built with their types. With types in the announcements too, Fast DDS first asks for each one that a process
# does not have, and only then tells of the endpoint: services of nodes were known 0.1 s later than topics.

PROFILE = """\
<?xml version="1.0" encoding="UTF-8" ?>
<dds xmlns="http://www.eprosima.com">
  <profiles>
    <transport_descriptors>
      <transport_descriptor>
        <transport_id>shared_memory</transport_id>
        <type>SHM</type>
        <segment_size>{segment}</segment_size>
      </transport_descriptor>
      <transport_descriptor>
        <transport_id>network</transport_id>
        <type>UDPv4</type>{interfaces}
      </transport_descriptor>
    </transport_descriptors>
    <participant profile_name="rce" is_default_profile="true">
      <rtps>
        <userTransports>
          <transport_id>shared_memory</transport_id>
          <transport_id>network</transport_id>
        </userTransports>
        <useBuiltinTransports>false</useBuiltinTransports>
        <propertiesPolicy>
          <properties>
            <property>
              <name>fastdds.type_propagation</name>
              <value>disabled</value>
            </property>
          </properties>
        </propertiesPolicy>
        <builtin>
          <discovery_config>
            <leaseAnnouncement>
              <sec>0</sec>
              <nanosec>200000000</nanosec>
            </leaseAnnouncement>
            <initialAnnouncements>
              <count>100</count>
              <period>
                <nanosec>20000000</nanosec>
              </period>
            </initialAnnouncements>
          </discovery_config>{peers}
        </builtin>
      </rtps>
    </participant>
    <data_writer profile_name="rce_writer" is_default_profile="true">
      <times>
        <heartbeat_period>
          <sec>0</sec>
          <nanosec>{heartbeat}</nanosec>
        </heartbeat_period>
      </times>
    </data_writer>
  </profiles>
</dds>
"""

# In a network group: the group's interface too, and the members' addresses beside multicast, which not all networks
# support. Members that come later have our address, and announce themselves to every participant here.
INTERFACES = """
        <interfaceWhiteList>{addresses}
        </interfaceWhiteList>
        <maxInitialPeersRange>{participants}</maxInitialPeersRange>
        <receiveBufferSize>{buffer}</receiveBufferSize>"""
INTERFACE = """
          <address>{address}</address>"""
PEERS = """
          <initialPeersList>{locators}
          </initialPeersList>"""
LOCATOR = """
            <locator>
              <udpv4>
                <address>{address}</address>
              </udpv4>
            </locator>"""
MULTICAST = "239.255.0.1"  # RTPS 2.5, 9.6.2.4
LOOPBACK = "127.0.0.1"  # without it nodes of one environment discover each other a second later, or never
BUFFER = 4 * MB  # for bursts of large messages; the kernel limits it to net.core.rmem_max
PARTICIPANTS = 32  # ROS processes of one environment that others find without multicast


def prepare(settings: Settings) -> None:
    """Set up directories, the Fast DDS profile and type support for this process, before rclpy is imported."""
    (settings.data_dir / "home").mkdir(parents=True, exist_ok=True)
    use_profile(settings.data_dir / "fastdds.xml", settings.shared_memory, settings.address, settings.peers)
    sys.path += python_paths(settings)
    malloc.keep_large_blocks()
    import_lazily("numpy")


def use_profile(path: Path, segment: int, address: str = "", peers: Sequence[str] = ()) -> None:
    """Write a profile of Fast DDS, for the participants that this process and its nodes make from now on.

    Args:
        path: File for the profile.
        segment: MB of the shared memory segment of each process.
        address: Address in the network group, if there is one.
        peers: Addresses of the other members.
    """
    if os.environ.get(RANGE) == "LOCALHOST":
        os.environ[RANGE] = NO_NETWORK
    path.write_text(_profile(segment, address, peers))
    os.environ["FASTDDS_DEFAULT_PROFILES_FILE"] = str(path)


def _profile(segment: int, address: str, others: Sequence[str]) -> str:
    no_network = os.environ.get(RANGE) == NO_NETWORK
    own = [address, LOOPBACK] if address else [LOOPBACK] if no_network else []
    addresses = "".join(INTERFACE.format(address=each) for each in own)
    peers = [MULTICAST, LOOPBACK, *dict.fromkeys([address, *others])] if address else []
    locators = "".join(map(_locator, peers))
    return PROFILE.format(
        segment=segment * MB,
        heartbeat=HEARTBEAT,
        interfaces=INTERFACES.format(addresses=addresses, participants=PARTICIPANTS, buffer=BUFFER) if own else "",
        peers=PEERS.format(locators=locators) if address else "",
    )


def _locator(address: str) -> str:
    return LOCATOR.format(address=address)


def install_prefixes(settings: Settings, environment: Mapping[str, str] = os.environ) -> list[Path]:
    """Return the install prefixes of ROS 2 packages: type support, a system ROS 2, and wheels."""
    system = [Path(entry) for entry in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]
    return list(dict.fromkeys([*settings.typesupport, *system, Path(sys.prefix)]))


def python_paths(settings: Settings) -> list[str]:
    """Return the directories of Python modules: type support, and what packages have built for this Python version."""
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    inside = (f"{version}-{platform.machine()}", f"lib/{version}/site-packages", f"local/lib/{version}/dist-packages")
    built = [prefix / "python" for prefix in settings.typesupport]
    pushed = [path for prefix in settings.package_path for part in inside if (path := prefix / part).is_dir()]
    return list(map(str, built + pushed))


def node_variables(settings: Settings, environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return the variables of a node that comes with RCE, which can import the packages of RCE."""
    libraries = [str(path / "lib") for path in settings.package_path if (path / "lib").is_dir()]
    ament = [str(path) for path in (*install_prefixes(settings, environment), *settings.package_path)]
    return {
        **{key: value for key, value in environment.items() if not key.startswith("RCE_")},
        **msgspec.json.decode(settings.env, type=dict[str, str]),
        MARKER: settings.run,
        SOCKET: str(settings.data_dir.absolute() / KNOWLEDGE),
        **({ADDRESS: settings.address} if settings.address else {}),
        "PATH": _joined([str(Path(sys.executable).parent)], environment.get("PATH", os.defpath)),
        "PYTHONPATH": _joined(python_paths(settings), environment.get("PYTHONPATH", "")),
        **({"LD_LIBRARY_PATH": _joined(libraries, environment.get("LD_LIBRARY_PATH", ""))} if libraries else {}),
        "PYTHONUNBUFFERED": "1",
        "AMENT_PREFIX_PATH": _joined(ament),
        **malloc.VARIABLES,
    }


def user_node_variables(variables: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of a user's node, given those of a node of RCE: the packages of RCE are hidden."""
    return {**variables, "PYTHONPATH": _joined([str(NODE_PATH)], variables["PYTHONPATH"])}


def _joined(first: list[str], rest: str = "") -> str:
    return os.pathsep.join([*first, *filter(None, [rest])])
