"""A Docker daemon for the tests: that of DOCKER_HOST if it answers, else a private one that ends with them."""

from __future__ import annotations

import os
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

START_TIMEOUT = 30.0
NOTHING_OF_THE_HOSTS = ("--bridge=none", "--iptables=false")
NEEDED = ("dockerd", "containerd", "runc", "iptables")


@contextmanager
def docker_daemon() -> Iterator[str]:
    """The address of a daemon; skips the test where there is none and none can be started."""
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
    """A daemon that ends with the block. In a network namespace it uses the packet filter, which is of that alone.

    After one that was killed it takes the mounts of that from a process which lives on, `beside`.
    """
    host = f"unix://{directory}/docker.sock"
    words = [
        "dockerd",
        f"--data-root={directory}/data",
        f"--exec-root={directory}/exec",
        f"-H={host}",
        f"--pidfile={directory}/pid",
    ]
    if namespace:  # with a /run of its own, else Docker takes the containerd and the locks of another daemon
        words = [*_in(namespace, beside), *words, "--bridge=none"]
    else:  # where a containerd runs already, this daemon shares it
        words += [f"--containerd{part}-namespace=rce-test-{os.getpid()}{part}" for part in ("", "-plugins")]
        words += NOTHING_OF_THE_HOSTS
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
        for mount in (directory / "exec" / "netns").glob("*"):  # it leaves them, and they cannot be removed
            subprocess.run(["umount", str(mount)], check=False, stderr=subprocess.DEVNULL)


def linked_images(api: docker.APIClient, data: Path) -> bool:
    """Whether a daemon yet to start in the directory `data` has got the images of this one. It does by hard links, in
    two seconds where saving and loading takes half a minute; not where it is on another disk. Layers never change."""
    info = api.info()
    root = Path(info["DockerRootDir"])
    data.mkdir()
    script = 'umount --lazy "$1"; exec cp --archive --link "$1/image" "$1/$2" "$3"'  # dockerd has it mounted on itself
    words = ["unshare", "--mount", "sh", "-c", script, "sh", str(root), info["Driver"], str(data)]
    done = subprocess.run(words, capture_output=True)
    if done.returncode:
        shutil.rmtree(data)
    return done.returncode == 0


def copy_image(source: docker.APIClient, target: docker.APIClient, tag: str) -> None:
    for _ in target.load_image(source.get_image(tag)):
        pass  # it is loaded when all has been said


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
