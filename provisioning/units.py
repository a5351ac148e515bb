"""systemd units of the services, each with minimal rights. Standard library only."""

from __future__ import annotations

from provisioning.system import CURRENT, DOCKER, ETC, USER, VAR

DESCRIPTIONS = {
    "master": "Master",
    "robot": "Robot endpoint",
    "container": "Container task set",
    "map-service": "map service",
    "knowledge-service": "knowledge service",
}
OF_PLATFORM = (f"{ETC}/authority", f"{ETC}/master.toml", f"{ETC}/robot.toml", f"{ETC}/container.toml")
DATA_OF_PLATFORM = (f"{VAR}/master", f"{VAR}/robot", f"{VAR}/container")
SECRETS = {  # files of other services, which a role cannot read
    "robot": (f"{ETC}/authority", f"{ETC}/master.toml", f"{ETC}/container.toml", f"{VAR}/master"),
    "container": (f"{ETC}/authority", f"{ETC}/master.toml", f"{VAR}/master"),
    "map-service": (*OF_PLATFORM, *DATA_OF_PLATFORM, f"{ETC}/knowledge-service.toml", f"{VAR}/knowledge-service"),
    "knowledge-service": (*OF_PLATFORM, *DATA_OF_PLATFORM, f"{ETC}/map-service.toml", f"{VAR}/map-service"),
    "master": (),
}
HARDENING = """\
NoNewPrivileges=yes
CapabilityBoundingSet=
AmbientCapabilities=
ProtectSystem=strict
ProtectHome=yes
ProtectProc=invisible
ProtectClock=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
ProtectControlGroups=yes
PrivateTmp=yes
PrivateDevices=yes
RestrictNamespaces=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
LockPersonality=yes
KeyringMode=private
UMask=0077
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallErrorNumber=EPERM
"""
# For services that listen to robots and machines, but run no users' programs. A user namespace of their own keeps them
# from the memory of the task set, which has the same user and may have access to Docker.
FACING_THE_NETWORK = """\
PrivateUsers=yes
RemoveIPC=yes
SystemCallFilter=~@privileged @resources
RestrictAddressFamilies=AF_INET AF_INET6 AF_UNIX
"""
# Services that start worker processes, which lower their own priority.
WITH_WORKERS = """\
SystemCallFilter=setpriority
"""
WORKERS = ("robot", "map-service")
# The map service compiles its Numba kernels once for all jobs. The files that it reads are not trusted.
WITH_KERNELS = f"""\
Environment=NUMBA_CACHE_DIR={VAR}/map-service/numba
"""
# Environments outlive the task set, and the next one adopts them. The process engine sets their limits, and DDS queries
# the network interfaces by netlink.
WITH_ENVIRONMENTS = """\
KillMode=process
RestrictAddressFamilies=AF_INET AF_INET6 AF_UNIX AF_NETLINK
"""
# The task set sets packet filters for network groups and for environments with egress.
WITH_NETWORKS = """\
CapabilityBoundingSet=CAP_NET_ADMIN
AmbientCapabilities=CAP_NET_ADMIN
"""
# A service that takes too much is restarted, and nothing else of the machine is killed. The shares exceed 100 %, as the
# services are not large at the same time.
MEMORY = {"master": "40%", "robot": "50%", "container": "25%", "map-service": "60%", "knowledge-service": "30%"}
TASKS = {"master": 512, "robot": 1024, "container": 1024, "map-service": 1024, "knowledge-service": 256}
# The control group of the process engine has the environments in it, which have no limits.
UNLIMITED = """\
TasksMax=infinity
"""
# Environments reserve ROS domains by locks in /tmp, which all platforms of this host share.
WITH_PROCESSES = """\
PrivateTmp=no
ReadWritePaths=/tmp
"""


def text(role: str, engine: str = "") -> str:
    """Return the unit file of a role."""
    return (
        f"[Unit]\n"
        f"Description=RCE {DESCRIPTIONS[role]}\n"
        f"After=network-online.target{_after(role, engine)}\n"
        f"Wants=network-online.target\n"
        f"StartLimitIntervalSec=0\n"  # restart without limit while the Master is away or being upgraded
        f"\n[Service]\n"
        f"ExecStart={CURRENT}/bin/rce {role} --config {ETC}/{role}.toml\n"
        f"User={USER}\nGroup={USER}\n"
        f"{_docker(role, engine)}"
        f"StateDirectory=rce/{role}\nStateDirectoryMode=0700\n"
        f"Restart=always\nRestartSec=2\nTimeoutStopSec=60\n"
        f"LimitNOFILE=65536\n"
        f"{_limits(role, engine)}"
        f"{WITH_KERNELS if role == 'map-service' else ''}"
        f"{HARDENING}"
        f"{WITH_ENVIRONMENTS if role == 'container' else FACING_THE_NETWORK}"
        f"{WITH_WORKERS if role in WORKERS else ''}"
        f"{WITH_NETWORKS if engine == 'docker' and role == 'container' else ''}"
        f"{WITH_PROCESSES if engine == 'process' and role == 'container' else ''}"
        f"{''.join(f'InaccessiblePaths=-{path}{chr(10)}' for path in SECRETS[role])}"
        f"\n[Install]\nWantedBy=multi-user.target\n"
    )


def _limits(role: str, engine: str) -> str:
    """Return limits of memory and processes. A worker process that the kernel kills does not stop its service."""
    limits = f"MemoryMax={MEMORY[role]}\nMemorySwapMax=0\nTasksMax={TASKS[role]}\n"
    return (UNLIMITED if engine == "process" and role == "container" else limits) + "OOMPolicy=continue\n"


def _after(role: str, engine: str) -> str:
    """Return the units to start before this one. It is an order only: services wait for each other by themselves."""
    first = "" if role == "master" else " rce-master.service"
    return first + (" docker.service" if role == "container" and engine in DOCKER else "")


def _docker(role: str, engine: str) -> str:
    """Give access to Docker, which is as good as root, to this unit only and not to the user that all units share."""
    return "SupplementaryGroups=docker\n" if role == "container" and engine in DOCKER else ""


def command(role: str, engine: str = "") -> str:
    """Return the command that runs the service without systemd."""
    program = f"{CURRENT}/bin/rce {role} --config {ETC}/{role}.toml"
    if role == "container" and engine == "docker":
        rights = "--inh-caps -all,+net_admin --ambient-caps -all,+net_admin --no-new-privs"
        return f"setpriv --reuid {USER} --regid {USER} --groups docker {rights} {program}"
    groups = " -G docker" if _docker(role, engine) else ""
    return f"runuser -u {USER} -g {USER}{groups} -- {program}"
