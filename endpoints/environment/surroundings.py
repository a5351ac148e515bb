"""What processes of an environment find around them: variables, the profile of Fast DDS, the behaviour of malloc."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Mapping
from pathlib import Path

import msgspec

from endpoints import memory
from endpoints.environment.later import load_later
from endpoints.environment.settings import Settings
from endpoints.memory import MB

ADDRESS = "RCE_GROUP_IP"  # tells nodes where in their network group they are
MARKER = "RCE_RUN"  # by this variable engines find what a killed endpoint has left
NODE_PATH = Path(__file__).with_name("nodepath")
# What a subscription has missed (the first messages of a publisher that it has just found; large ones when the segment
# was full) is sent again after the next heartbeat; with the 3 s of the default that is a slow mode of 3 s.
HEARTBEAT = 20_000_000  # ns
# Within one host shared memory does it all, and the loopback interface where Fast DDS does not see that two processes
# are on one host: it tells hosts apart by the addresses that they had when a process began. For LOCALHOST rmw adds
# transports of its own beside those of a profile: nodes then take up to 3 s to find each other, and 0.1 s so.
RANGE, ALONE = "ROS_AUTOMATIC_DISCOVERY_RANGE", "SYSTEM_DEFAULT"

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
        <builtin>
          <discovery_config>
            <leaseAnnouncement>
              <sec>1</sec>
            </leaseAnnouncement>
            <initialAnnouncements>
              <count>20</count>
              <period>
                <nanosec>100000000</nanosec>
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

# In a network group: its interface too, and the members' addresses beside multicast, which not all networks carry.
# Later members have ours, and they announce themselves to every participant here.
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
LOOPBACK = "127.0.0.1"  # without it nodes of one environment do not find each other, or a second later
BUFFER = 4 * MB  # for bursts of large messages; the kernel gives net.core.rmem_max at most
PARTICIPANTS = 32  # processes with ROS of one environment that others find without multicast


def prepare(settings: Settings) -> None:
    """Directories, profile and type support of this very process; before rclpy is imported."""
    (settings.data_dir / "home").mkdir(parents=True, exist_ok=True)
    profile = settings.data_dir / "fastdds.xml"
    if os.environ.get(RANGE) == "LOCALHOST":
        os.environ[RANGE] = ALONE
    profile.write_text(_profile(settings))
    os.environ["FASTDDS_DEFAULT_PROFILES_FILE"] = str(profile)
    sys.path += python_paths(settings)
    memory.keep_large_blocks()
    load_later("numpy")


def _profile(settings: Settings) -> str:
    address, alone = settings.address, os.environ.get(RANGE) == ALONE
    own = [address, LOOPBACK] if address else [LOOPBACK] if alone else []
    addresses = "".join(INTERFACE.format(address=each) for each in own)
    peers = [MULTICAST, LOOPBACK, *dict.fromkeys([address, *settings.peers])] if address else []
    locators = "".join(map(_locator, peers))
    return PROFILE.format(
        segment=settings.shared_memory * MB,
        heartbeat=HEARTBEAT,
        interfaces=INTERFACES.format(addresses=addresses, participants=PARTICIPANTS, buffer=BUFFER) if own else "",
        peers=PEERS.format(locators=locators) if address else "",
    )


def _locator(address: str) -> str:
    return LOCATOR.format(address=address)


def prefixes(settings: Settings, environment: Mapping[str, str] = os.environ) -> list[Path]:
    """Where ROS 2 packages are installed: type support, a system ROS 2, wheels."""
    system = [Path(entry) for entry in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]
    return list(dict.fromkeys([*settings.typesupport, *system, Path(sys.prefix)]))


def python_paths(settings: Settings) -> list[str]:
    """Where Python modules of types and nodes are: type support, and what packages have built for this Python."""
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    inside = (f"{version}-{platform.machine()}", f"lib/{version}/site-packages", f"local/lib/{version}/dist-packages")
    built = [prefix / "python" for prefix in settings.typesupport]
    pushed = [path for prefix in settings.package_path for part in inside if (path := prefix / part).is_dir()]
    return list(map(str, built + pushed))


def for_nodes(settings: Settings, environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The variables of a node that comes with RCE; it finds all that we find."""
    libraries = [str(path / "lib") for path in settings.package_path if (path / "lib").is_dir()]
    ament = [str(path) for path in (*prefixes(settings, environment), *settings.package_path)]
    return {
        **{key: value for key, value in environment.items() if not key.startswith("RCE_")},
        **msgspec.json.decode(settings.env, type=dict[str, str]),
        MARKER: settings.run,
        **({ADDRESS: settings.address} if settings.address else {}),
        "PATH": _joined([str(Path(sys.executable).parent)], environment.get("PATH", os.defpath)),
        "PYTHONPATH": _joined(python_paths(settings), environment.get("PYTHONPATH", "")),
        **({"LD_LIBRARY_PATH": _joined(libraries, environment.get("LD_LIBRARY_PATH", ""))} if libraries else {}),
        "PYTHONUNBUFFERED": "1",
        "AMENT_PREFIX_PATH": _joined(ament),
        **memory.VARIABLES,
    }


def for_users_nodes(variables: Mapping[str, str]) -> dict[str, str]:
    """The same without sight of our own packages."""
    return {**variables, "PYTHONPATH": _joined([str(NODE_PATH)], variables["PYTHONPATH"])}


def _joined(first: list[str], rest: str = "") -> str:
    return os.pathsep.join([*first, *filter(None, [rest])])
