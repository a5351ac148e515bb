"""The filter of system calls, in a container of a real daemon."""

from __future__ import annotations

import json

import pytest

from tests.support.containers.engine_contract import Endings, opened, spec

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.docker import seccomp
from tests.support.containers.docker_world import DockerWorld

NEEDED = ("unix", "inet", "inet6", "routes", "fork")
ATTACKS = ("netfilter", "vsock", "algorithms", "can", "io_uring", "aio", "unshare", "clone")


async def test_only_needed_calls_are_allowed(docker_world: DockerWorld, endings: Endings) -> None:
    async with opened(docker_world.engine(endings, "calls")) as engine:
        await engine.start(spec())
        ended = await endings.next()
    seen = dict(line.split(": ") for line in ended.lines if ": " in line)
    assert {name: seen[name] for name in NEEDED} == dict.fromkeys(NEEDED, "allowed")
    refused = dict.fromkeys(ATTACKS, "Operation not permitted") | {"io_uring": "Function not implemented"}
    assert {name: seen[name] for name in ATTACKS} == refused


def test_calls_that_reach_other_namespaces_or_the_kernel_are_not_listed() -> None:
    names = {name for rule in json.loads(seccomp.profile())["syscalls"] for name in rule["names"]}
    assert not names & {
        *("mount", "umount2", "unshare", "setns", "pivot_root", "chroot", "open_by_handle_at", "name_to_handle_at"),
        *("bpf", "perf_event_open", "userfaultfd", "keyctl", "add_key", "request_key", "kexec_load", "init_module"),
        *("socketcall", "ipc", "modify_ldt", "io_setup", "process_madvise", "pidfd_getfd", "kcmp", "reboot", "syslog"),
    }


def test_calls_are_listed_once() -> None:
    assert len(seccomp.ALLOWED) == len(set(seccomp.ALLOWED))
