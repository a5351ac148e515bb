"""Docker daemon for the tests: that of DOCKER_HOST if it answers, else a private one that ends with them."""

from __future__ import annotations

import os
import secrets
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import docker
import pytest
from docker.errors import DockerException

START_TIMEOUT = 120.0
NO_HOST_NETWORK = ("--bridge=none", "--iptables=false")  # does not change the network of this machine
NEEDED = ("dockerd", "containerd", "runc", "iptables")


@contextmanager
def docker_daemon() -> Iterator[str]:
    """Yield the address of a daemon; skip the test if there is none and none can be started."""
    given = os.environ.get("DOCKER_HOST", "")
    if given and _answers(given):
        yield given
        return
    lacking = [name for name in NEEDED if shutil.which(name, path=os.environ["PATH"] + ":/usr/sbin:/sbin") is None]
    if lacking:
        pytest.skip(f"no {', '.join(lacking)}: install docker.io, containerd, runc and iptables, or set DOCKER_HOST")
    if os.geteuid() != 0:
        pytest.skip("a private dockerd needs root: run the tests as root, or set DOCKER_HOST")
    with (
        tempfile.TemporaryDirectory(prefix="rce-docker-", ignore_cleanup_errors=True) as directory,
        private_daemon(Path(directory)) as host,
    ):
        yield host


@contextmanager
def private_daemon(directory: Path, namespace: str = "", beside: int = 0) -> Iterator[str]:
    """Run a daemon during the block; yield its address.

    In a network namespace the daemon uses the packet filter, which belongs to that namespace alone. After a daemon that
    was killed, the next one joins the mount namespace of a process that survived it, `beside`.
    """
    host = f"unix://{directory}/docker.sock"
    words = [
        "dockerd",
        f"--data-root={directory}/data",
        f"--exec-root={directory}/exec",
        f"-H={host}",
        f"--pidfile={directory}/pid",
    ]
    if namespace:  # with a /run of its own, else it would use the containerd and the locks of another daemon
        words = [*_in(namespace, beside), *words, "--bridge=none"]
    else:  # it shares a containerd that runs already; an unused namespace there has no state of an earlier test run
        unique = f"rce-test-{secrets.token_hex(4)}"
        words += [f"--containerd{part}-namespace={unique}{part}" for part in ("", "-plugins")]
        words += NO_HOST_NETWORK
    with (directory / "log").open("w") as log:
        daemon = subprocess.Popen(
            words,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
    try:
        until = time.monotonic() + START_TIMEOUT
        while not _answers(host):
            if daemon.poll() is not None or time.monotonic() > until:
                last = "\n".join((directory / "log").read_text().splitlines()[-5:])
                pytest.skip(f"a private dockerd does not start here: {last}")
            time.sleep(0.1)
        yield host
    finally:
        daemon.terminate()
        daemon.wait(60)
        for mount in (directory / "exec" / "netns").glob("*"):  # Docker leaves these mounts behind
            subprocess.run(["umount", str(mount)], check=False, stderr=subprocess.DEVNULL)


def linked_images(api: docker.APIClient, data: Path) -> bool:
    """Give the images of this daemon to one that is yet to start in the directory `data`, by hard links.

    That takes two seconds, where saving and loading takes half a minute, and is safe as layers never change.

    Returns:
        False if `data` is on another file system.
    """
    info = api.info()
    root = Path(info["DockerRootDir"])
    data.mkdir()
    script = (
        'umount --lazy "$1"; exec cp --archive --link "$1/image" "$1/$2" "$3"'  # dockerd bind-mounts its root on itself
    )
    words = ["unshare", "--mount", "sh", "-c", script, "sh", str(root), info["Driver"], str(data)]
    done = subprocess.run(words, capture_output=True)
    if done.returncode:
        shutil.rmtree(data)
    return done.returncode == 0


def copy_image(source: docker.APIClient, target: docker.APIClient, tag: str) -> None:
    for _ in target.load_image(source.get_image(tag)):
        pass  # the image is loaded at the end of the progress messages


def _in(namespace: str, beside: int) -> list[str]:
    enter = ["nsenter", f"--net=/run/netns/{namespace}"]
    if beside:
        return [*enter, f"--mount=/proc/{beside}/ns/mnt"]
    script = 'mount -t tmpfs none /run && mkdir -p /run/docker && exec "$@"'
    return [*enter, "unshare", "--mount", "sh", "-c", script, "sh"]


def _answers(host: str) -> bool:
    try:
        return bool(docker.APIClient(base_url=host, version="auto", timeout=10).ping())
    except (DockerException, OSError):
        return False
