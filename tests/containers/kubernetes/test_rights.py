"""The engine with no other rights than those of the manifests: one environment from its start to its end."""

from __future__ import annotations

import base64
import json
import os
import time
from pathlib import Path

import pytest

pytest.importorskip("kubernetes_asyncio", reason="needs kubernetes_asyncio: pip install '.[kubernetes]'")
pytest.importorskip("docker", reason="nodes of the tests need docker-py: pip install '.[docker]'")

import yaml

from containers.endpoint import OPEN_FILES, environment_user
from provisioning.kubernetes import Values, manifests
from rce.protocol.slots import MB
from tests.support.containers.engine_contract import Endings, opened, with_options
from tests.support.containers.kubernetes_world import KubernetesWorld
from tests.support.kubernetes.cluster import NAMESPACE, Cluster

RIGHTS = ("ServiceAccount", "Role", "RoleBinding", "ClusterRole", "ClusterRoleBinding")
NO_PRIVILEGES = ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb")


@pytest.fixture
def as_task_set(cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the engine the service account of the manifests in place of the administrator's rights."""
    objects = [each for each in manifests(Values(namespace=NAMESPACE)) if each["kind"] in RIGHTS]
    cluster.kubectl("apply", "--filename=-", given=json.dumps({"apiVersion": "v1", "kind": "List", "items": objects}))
    account = f"system:serviceaccount:{NAMESPACE}:rce-tasks"
    config = yaml.safe_load(cluster.kubeconfig.read_text())
    config["users"][0]["user"] = {"token": token(cluster)}
    file = tmp_path / "kubeconfig"
    file.write_text(yaml.safe_dump(config))
    monkeypatch.setitem(os.environ, "KUBECONFIG", str(file))
    assert (
        cluster.kubectl("auth", "can-i", "list", "pods", "--all-namespaces", f"--as={account}", check=False) == "no\n"
    )


def token(cluster: Cluster) -> str:
    """Return the token that Kubernetes makes for the service account."""
    until = time.monotonic() + 60
    while True:
        for each in cluster.get("secrets", "--field-selector=type=kubernetes.io/service-account-token"):
            if each["metadata"]["annotations"]["kubernetes.io/service-account.name"] == "rce-tasks":
                return base64.b64decode(each["data"]["token"]).decode()
        assert time.monotonic() < until, "the service account has no token"
        time.sleep(0.2)


@pytest.mark.sample
@pytest.mark.usefixtures("as_task_set")
async def test_rights_of_the_manifests_suffice(world: KubernetesWorld, endings: Endings) -> None:
    """The environment is confined, adopted by the next engine, and reported when it ends."""
    one = with_options(memory=300 * MB, cpu=0.5, pids=64, bandwidth=MB)
    async with opened(world.engine(endings)) as engine:
        await engine.start(one)
        check_confinement(world.process(one.name))
        assert (await engine.usage())[one.name].memory > 0
        assert world.places().control(one.run).is_dir()
        await engine.close()
        later = Endings()
        async with opened(world.engine(later)) as again:
            assert set(again.running()) == {one.name}
            await world.end(one.name)
            ended = await later.next()
            assert (ended.status, ended.lines[-1]) == (3, "last words")
    assert world.remains() == set()


def check_confinement(process: int) -> None:
    """Check by /proc what a process is confined to."""
    status = dict(line.split(":\t", 1) for line in Path(f"/proc/{process}/status").read_text().splitlines())
    assert {int(status[each], 16) for each in NO_PRIVILEGES} == {0}
    assert (status["NoNewPrivs"], status["Seccomp"]) == ("1", "2")
    assert int(status["Uid"].split()[0]) == environment_user("ann/map")
    lines = Path(f"/proc/{process}/limits").read_text().splitlines()
    assert [str(OPEN_FILES)] * 2 in [line.split()[3:5] for line in lines if line.startswith("Max open files")]
    assert "64" in group_files(process, "pids.max")
    mounts = [line.split() for line in Path(f"/proc/{process}/mounts").read_text().splitlines()]
    assert [options.split(",")[0] for _, place, _, options, *_ in mounts if place in ("/", "/run/rce")] == ["ro", "ro"]
    (home,) = [options for _, place, _, options, *_ in mounts if place == "/home/rce"]
    assert {"nosuid", "nodev", "size=262144k", "nr_inodes=50000"} <= set(home.split(","))
    routes = Path(f"/proc/{process}/net/route").read_text().splitlines()[1:]
    assert routes == [], "no interface is up"


def group_files(process: int, name: str) -> list[str]:
    """Return the contents of a file of the control groups of a process."""
    found = []
    for line in Path(f"/proc/{process}/cgroup").read_text().splitlines():
        _, controllers, path = line.split(":", 2)
        file = Path("/sys/fs/cgroup") / controllers / path.lstrip("/") / name
        if file.exists():
            found.append(file.read_text().strip())
    return found
