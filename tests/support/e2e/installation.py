"""`provision install` in a copy-on-write image of this system, with a network namespace.

The services are installed and started with the commands of their units, but none of environments. A robot connects, a
second machine joins, `doctor` checks the installation, and `uninstall` removes it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from provisioning.system import KNOWN, System, program

TIMEOUT = 500  # seconds; about 50 on an idle machine with pip's cache filled
SYSTEM = """
mount -t tmpfs -o mode=755 tmpfs "$1"
mkdir "$1/upper" "$1/work" "$1/root"
mount -t overlay overlay -o "lowerdir=/,upperdir=$1/upper,workdir=$1/work" "$1/root"
mount --rbind /proc "$1/root/proc"
mount --rbind /dev "$1/root/dev"
mkdir -p "$1/root/$2"
mount --bind "$2" "$1/root/$2"
rm -rf "$1/root/run/systemd/system"
exec chroot "$1/root" sh -euc "$3" sh "$2"
"""
LIFE = """
provision="$1/provisioning/provision"
$provision install --role master,robot --name alpha --address 127.0.0.1
$provision install | grep -c 'already done'
exec unshare -n sh -euc "$2" sh "$provision"
"""
RUN = """
ip link set lo up
cd /
rce=/opt/rce/current/bin
as="runuser -u rce -g rce --"
for role in master robot map-service knowledge-service; do
    $as $rce/rce $role --config /etc/rce/$role.toml > /tmp/$role.log 2>&1 &
done
trap 'cat /tmp/master.log /tmp/robot.log /tmp/*-service.log >&2; kill $(jobs -p)' EXIT
for role in robot map-service knowledge-service; do
    for turn in $(seq 300); do
        grep -q "\\"program\\":\\"$role\\"" /tmp/$role.log && break
        sleep 0.2
    done
done
echo 'r2d2-password' | $as $rce/rce user --data-dir=/var/lib/rce/master add ada
SSL_CERT_FILE=/etc/rce/tls/ca.pem $rce/python -P -c '
import asyncio
from rce.client import Robot
async def main():
    async with Robot("https://127.0.0.1:9000/", user="ada", robot="r2d2", password="r2d2-password"):
        print("robot: connected")
asyncio.run(main())'
code=$($1 machine add beta --role container | grep -o 'rce1-.*')
mkdir /tmp/beta
printf %s "$code" | $rce/python -P -m provisioning.identity --directory /tmp/beta join > /tmp/beta/membership.json
echo "machine: $(ls /tmp/beta | tr '\\n' ' ')"
printf %s "$code" | $rce/python -P -m provisioning.identity --directory /tmp/beta join 2>&1 || echo refused
$1 doctor --json > /tmp/findings.json && echo "doctor: ok"
tr -d '\\n' < /tmp/findings.json; echo
trap - EXIT
$1 uninstall --purge
echo "left: $(ls -d /opt/rce /etc/rce /var/lib/rce /etc/systemd/system/rce-* 2> /dev/null) $(grep -c ^rce: /etc/passwd)"
"""


@contextmanager
def image_directory(directory: Path, checkout: Path) -> Iterator[Path]:
    """Make the mount point of the image, or skip the test where no such image can be made."""
    if os.geteuid() != 0:
        pytest.skip("an image of this system needs root")
    if System().release() not in KNOWN or System().roles():
        pytest.skip(f"for {sorted(KNOWN)}, where nothing of RCE is installed")
    lacking = [name for name in ("ip", "unshare", "runuser", "useradd") if program(name) is None]
    if lacking:
        pytest.skip(f"no {', '.join(lacking)}: apt-get install iproute2 util-linux passwd")
    place = directory / "image"
    place.mkdir()
    script = SYSTEM.replace('exec chroot "$1/root" sh -euc "$3" sh "$2"', "")
    probe = subprocess.run(["unshare", "-mn", "sh", "-euc", script, "sh", place, checkout], capture_output=True)
    if probe.returncode:
        pytest.skip(f"no image of this system can be made here: {probe.stderr.decode()[-200:]}")
    yield place
    shutil.rmtree(place)


def install_and_remove(place: Path, checkout: Path) -> list[str]:
    """Install from a checkout, use the installation, and remove it; return the lines that were printed."""
    quoted = RUN.replace("'", "'\\''")
    life = LIFE.replace('"$2"', f"'{quoted}'")
    command = ["unshare", "-m", "sh", "-euc", SYSTEM, "sh", str(place), str(checkout), life]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    return done.stdout.splitlines()
