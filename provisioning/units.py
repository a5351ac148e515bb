"""The services as systemd units, each with no more rights than it uses. Standard library only."""

from __future__ import annotations

from provisioning.system import CURRENT, DOCKER, ETC, USER, VAR

WHAT = {
    "master": "Master",
    "robot": "Robot endpoint",
    "container": "Container task set",
    "map-service": "map service",
}
SECRETS = {  # of the Master, which the other services on its machine do not see
    "robot": (f"{ETC}/authority", f"{ETC}/master.toml", f"{ETC}/container.toml", f"{VAR}/master"),
    "container": (f"{ETC}/authority", f"{ETC}/master.toml", f"{VAR}/master"),
    "map-service": (
        *(f"{ETC}/authority", f"{ETC}/master.toml", f"{ETC}/robot.toml", f"{ETC}/container.toml", f"{VAR}/master"),
        *(f"{VAR}/robot", f"{VAR}/container"),
    ),
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
# The robots' and machines' ports are theirs; nothing that they run is a program of somebody else. An own user namespace
# keeps them from the memory of the task set, which has the same user and may have Docker.
FACING_THE_NETWORK = """\
PrivateUsers=yes
RemoveIPC=yes
SystemCallFilter=~@privileged @resources
RestrictAddressFamilies=AF_INET AF_INET6 AF_UNIX
"""
# It compiles its kernels once for all jobs; what it reads are strangers' files.
WITH_KERNELS = f"""\
Environment=NUMBA_CACHE_DIR={VAR}/map-service/numba
"""
# Environments outlive the task set, which the next one adopts; the process engine sets their limits and DDS asks the
# kernel for the network interfaces.
WITH_ENVIRONMENTS = """\
KillMode=process
RestrictAddressFamilies=AF_INET AF_INET6 AF_UNIX AF_NETLINK
"""
# It guards the networks of groups and of environments that reach out by the packet filter.
WITH_NETWORKS = """\
CapabilityBoundingSet=CAP_NET_ADMIN
AmbientCapabilities=CAP_NET_ADMIN
"""
# Its environments hold ROS domains by locks in /tmp, which all platforms of this host share and which outlive it.
WITH_PROCESSES = """\
PrivateTmp=no
ReadWritePaths=/tmp
"""


def text(role: str, engine: str = "") -> str:
    """The unit of a role."""
    return (
        f"[Unit]\n"
        f"Description=RCE {WHAT[role]}\n"
        f"After=network-online.target{_after(role, engine)}\n"
        f"Wants=network-online.target\n"
        f"StartLimitIntervalSec=0\n"  # it waits for a Master that is away, or upgraded first, as long as that takes
        f"\n[Service]\n"
        f"ExecStart={CURRENT}/bin/rce {role} --config {ETC}/{role}.toml\n"
        f"User={USER}\nGroup={USER}\n"
        f"{_docker(role, engine)}"
        f"StateDirectory=rce/{role}\nStateDirectoryMode=0700\n"
        f"Restart=always\nRestartSec=2\nTimeoutStopSec=60\n"
        f"LimitNOFILE=65536\n"
        f"{WITH_KERNELS if role == 'map-service' else ''}"
        f"{HARDENING}"
        f"{WITH_ENVIRONMENTS if role == 'container' else FACING_THE_NETWORK}"
        f"{WITH_NETWORKS if engine == 'docker' and role == 'container' else ''}"
        f"{WITH_PROCESSES if engine == 'process' and role == 'container' else ''}"
        f"{''.join(f'InaccessiblePaths=-{path}{chr(10)}' for path in SECRETS[role])}"
        f"\n[Install]\nWantedBy=multi-user.target\n"
    )


def _after(role: str, engine: str) -> str:
    """Order only: each may run without the other, and finds it when it is there."""
    first = "" if role == "master" else " rce-master.service"
    return first + (" docker.service" if role == "container" and engine in DOCKER else "")


def _docker(role: str, engine: str) -> str:
    """Who may speak to Docker is as good as root, so this one service may, not the user that it shares with others."""
    return "SupplementaryGroups=docker\n" if role == "container" and engine in DOCKER else ""


def command(role: str, engine: str = "") -> str:
    """What the unit starts, by hand."""
    program = f"{CURRENT}/bin/rce {role} --config {ETC}/{role}.toml"
    if role == "container" and engine == "docker":
        rights = "--inh-caps -all,+net_admin --ambient-caps -all,+net_admin --no-new-privs"
        return f"setpriv --reuid {USER} --regid {USER} --groups docker {rights} {program}"
    groups = " -G docker" if _docker(role, engine) else ""
    return f"runuser -u {USER} -g {USER}{groups} -- {program}"
