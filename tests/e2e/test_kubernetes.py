"""The platform with the engine `kubernetes` on two nodes, of which one is drained, and one is lost."""

from __future__ import annotations

import asyncio
import base64
import json
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("kubernetes_asyncio", reason="needs kubernetes_asyncio: pip install '.[kubernetes]'")
pytest.importorskip("docker", reason="nodes of the tests need docker-py: pip install '.[docker]'")

from containers.kubernetes.objects import RUN, SPEC
from provisioning.kubernetes import Values, manifests, rights_per_user
from rce.api.client import ApiClient
from rce.api.views import NewSecret, SecretView
from rce.protocol.messages import Qos
from tests.support.containers.stand_in_image import stand_in_layer
from tests.support.e2e import hostile_programs as programs
from tests.support.e2e.machines import Host, Machines
from tests.support.e2e.mapping import SCANS, check_files, rce_map, relations
from tests.support.e2e.real_platform import USER, until
from tests.support.e2e.traffic import Echo
from tests.support.kubernetes.cluster import NAMESPACE, Cluster, cluster_of
from tests.support.kubernetes.images import load_images
from tests.support.paths import DATA
from tests.support.swarm_nodes import HOST_IMAGE, host_mounts

STRING = "std_msgs/String"
SECRET = "correct horse battery"
MOVE_TIMEOUT = 180.0
RESOLVE = "import socket; print(socket.gethostbyname('{}'))"
CONNECT = """
found = {}
for address in sys.argv[1:]:
    for port in (53, 80, 443, 6443, 10250):
        found[f"{address}:{port}"] = attempt(lambda: socket.create_connection((address, port), 2).close())
say(**found)
"""


@pytest.fixture(scope="module")
def two_nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    stand_in = stand_in_layer(tmp_path_factory.mktemp("stand-in"))
    with cluster_of(2, lambda node: load_images(node, stand_in, mapping=True)) as made:
        yield made


@pytest.fixture(scope="module")
async def platform(
    two_nodes: Cluster, arguments: list[str], tmp_path_factory: pytest.TempPathFactory
) -> AsyncIterator[Machines]:
    words = [f"{option}={value}" for option, value in zip(arguments[::2], arguments[1::2], strict=True)]
    words += ["--engine=kubernetes", f"--namespace={NAMESPACE}", f"--agent-address={two_nodes.address}"]
    words += [f"--image={HOST_IMAGE}", f"--agent-image={HOST_IMAGE}", f"--mounts={','.join(host_mounts())}"]
    words += [f"--node-directory={two_nodes.common}/rce"]
    words += [f"--seccomp-directory={two_nodes.common}/kubelet/seccomp"]
    master = Host("master", two_nodes.address)
    async with Machines(tmp_path_factory.mktemp("platform"), master, [Host("here")], words, 10) as made:
        yield made
    assert not pods(two_nodes), "pods were not removed"


def pods(cluster: Cluster) -> dict[str, dict[str, Any]]:
    """Return the running pods of environments by tag."""
    found = {}
    for pod in cluster.get("pods", f"--selector={RUN}"):
        states = pod["status"].get("containerStatuses") or [{}]
        if "running" in states[0].get("state", {}) and "deletionTimestamp" not in pod["metadata"]:
            found[json.loads(pod["metadata"]["annotations"][SPEC])["name"].partition("/")[2]] = pod
    return found


def places(cluster: Cluster) -> dict[str, str]:
    """Return the node of each running environment by tag."""
    return {tag: pod["spec"]["nodeName"] for tag, pod in pods(cluster).items()}


async def run_in(cluster: Cluster, tag: str, program: str, *arguments: str) -> str:
    pod = pods(cluster)[tag]["metadata"]["name"]
    words = ("exec", f"--namespace={NAMESPACE}", pod, "--", "python3", "-P", "-c", program, *arguments)
    return await asyncio.to_thread(cluster.kubectl, *words)


async def test_environments_move_from_a_drained_node(two_nodes: Cluster, platform: Machines) -> None:
    """A message passes from the robot to nodes in two environments and back, before and after they share a node."""
    cluster = two_nodes
    async with platform.robot("r1") as robot, robot.environment("one") as one:
        first = places(cluster)["one"]
        cluster.kubectl("cordon", first)
        async with robot.environment("two") as two:
            cluster.kubectl("uncordon", first)
            second = places(cluster)["two"]
            assert second != first
            for environment in (one, two):
                await environment.add_node("echo", "rce_demo", "echo.py")
            await robot.add_interface("one", "out", "SubscriberInterface", STRING, addr="/heard")
            await robot.add_interface("two", "in", "PublisherInterface", STRING, addr="/say")
            await robot.connect("one/out", "two/in")
            chain = Echo(await one.publisher("/say", STRING), await two.subscriber("/heard", STRING))
            await chain.answers()
            drain = ("drain", second, "--ignore-daemonsets", "--force", "--delete-emptydir-data", "--timeout=120s")
            await asyncio.to_thread(cluster.kubectl, *drain)
            try:
                await until(lambda: places(cluster).get("two") == first, MOVE_TIMEOUT)
                await chain.answers(MOVE_TIMEOUT)
            finally:
                cluster.kubectl("uncordon", second)


async def test_group_is_one_ros_graph_over_two_nodes(two_nodes: Cluster, platform: Machines) -> None:
    """A node in one environment answers messages from the other, and each resolves the name of the other."""
    cluster = two_nodes
    async with platform.robot("r2") as robot, robot.environment("left", group="pair", group_ip="192.168.1.9") as left:
        first = places(cluster)["left"]
        cluster.kubectl("cordon", first)
        async with robot.environment("right", group="pair") as right:
            cluster.kubectl("uncordon", first)
            assert places(cluster)["right"] != first
            await right.add_node("echo", "rce_demo", "echo.py")
            await Echo(await left.publisher("/say", STRING), await left.subscriber("/heard", STRING)).answers()
            address = (await run_in(cluster, "right", RESOLVE.format("left"))).strip()
            assert address.endswith(".9"), address
            assert (await run_in(cluster, "left", RESOLVE.format("right"))).startswith(address[:-1])
            assert await reached(cluster, "left") == []


async def reached(cluster: Cluster, tag: str) -> list[str]:
    """Return the addresses that a program in an environment reaches of the cluster, its nodes and pods, and clouds."""
    others = [pod["status"].get("podIP", "") for pod in cluster.get("pods")]
    addresses = {cluster.address, "10.232.0.1", "169.254.169.254", *others, *(node.address for node in cluster.nodes)}
    output = await run_in(cluster, tag, programs.HEAD + CONNECT, *sorted(addresses - {""}))
    found: dict[str, str] = json.loads(output)
    own = pods(cluster)[tag]["status"].get("podIP", "")
    return [address for address, result in found.items() if result == "succeeded" and address.partition(":")[0] != own]


async def test_environment_reaches_nothing_and_sees_nothing_of_its_node(two_nodes: Cluster, platform: Machines) -> None:
    """The agent has taken down the pod's interface; there is neither a token, nor a program as another user."""
    async with platform.robot("hostile") as robot, robot.environment("siege"):
        assert await reached(two_nodes, "siege") == []
        seen = json.loads(await run_in(two_nodes, "siege", programs.HEAD + LOOK))
        assert seen["interfaces"] == ["lo"]
        assert seen["token"] is False
        assert seen["processes"] < 10
        assert seen["writable"] == ["/dev/shm", "/home/rce", "/tmp"]
        assert "not permitted" in seen["unshare"]
        assert "not permitted" in seen["mount"]
        assert "not permitted" in seen["interface"]


async def test_secret_reaches_the_nodes_of_a_pod(two_nodes: Cluster, platform: Machines) -> None:
    """A node reads a secret of its user as a file and as a variable; Kubernetes' objects do not have it."""
    url = platform.master.ready["url"]
    client = ApiClient(url, user=USER, password=USER)
    await asyncio.to_thread(client.post, SecretView, "secrets", body=NewSecret("password", SECRET))
    async with platform.robot("r5") as robot, robot.environment("safe", secrets={"password": "PASSWORD"}) as safe:
        await safe.add_node("look", "Relay", "secrets_seen.py")
        latched = Qos(durability="transient_local")
        seen = await (await safe.subscriber("/seen", STRING, qos=latched)).get(60)
        assert json.loads(seen["data"]) == {"file": SECRET, "variable": SECRET}
        objects = two_nodes.kubectl("get", "pods,secrets", f"--namespace={NAMESPACE}", "--output=json")
        assert SECRET not in objects
        assert base64.b64encode(SECRET.encode()).decode() not in objects


LOOK = """
import ctypes, fcntl, struct
libc = ctypes.CDLL(None, use_errno=True)
def call(name, *words):
    return "succeeded" if getattr(libc, name)(*words) == 0 else os.strerror(ctypes.get_errno())
def up(index):
    return int(open(f"/sys/class/net/{index}/flags").read(), 16) & 1
def bring_up():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plug:
        fcntl.ioctl(plug, 0x8914, struct.pack("16sH14s", b"eth0", 1, b""))
def writable(path):
    try:
        open(path + "/probe", "w").close()
        os.unlink(path + "/probe")
        return True
    except OSError:
        return False
mounts = [line.split()[1] for line in open("/proc/self/mounts")]
skipped = ("/proc", "/sys", "/dev/pts", "/dev/mqueue", "/dev/termination-log")
say(
    interfaces=sorted(each for each in os.listdir("/sys/class/net") if up(each)),
    token=os.path.exists("/var/run/secrets/kubernetes.io/serviceaccount/token"),
    processes=len([each for each in os.listdir("/proc") if each.isdigit()]),
    writable=sorted(each for each in mounts if not each.startswith(skipped) and os.path.isdir(each) and writable(each)),
    unshare=call("unshare", 0x10000000),
    mount=call("mount", b"none", b"/tmp", b"tmpfs", 0, None),
    interface=attempt(bring_up),
)
"""


@pytest.mark.parametrize("program", ["FORK_BOMB", "OPEN_FILES"])
async def test_greedy_programs_stay_within_their_limits(program: str, two_nodes: Cluster, platform: Machines) -> None:
    """Another environment on the cluster answers all the time."""
    async with (
        platform.robot("greedy") as robot,
        robot.environment("siege"),
        robot.environment("victim") as victim,
    ):
        echo = await Echo.of(victim)
        await echo.answers()
        words = programs.HEAD + getattr(programs, program)
        attack = asyncio.create_task(run_in(two_nodes, "siege", words))
        await echo.answers()
        await asyncio.wait({attack}, timeout=60)
        attack.cancel()
        await echo.answers()


@pytest.mark.skipif(not (DATA / "mit-csail.clf.gz").exists(), reason=f"needs mit-csail.clf.gz in {DATA}, or RCE_DATA")
async def test_mit_csail_is_mapped_on_the_cluster(platform: Machines, tmp_path: Path) -> None:
    url = platform.master.ready["url"]
    done = await rce_map(DATA / "mit-csail.clf.gz", "--url", url, "--out", tmp_path / "map", temporary=tmp_path)
    assert done.status == 0, done.errors
    check_files(tmp_path / "map", SCANS)
    print(await relations(tmp_path / "map" / "trajectory.txt"))


async def test_environment_moves_from_a_lost_node(two_nodes: Cluster, platform: Machines) -> None:
    """The node loses its kubelet and its network; when it returns, its old container is removed."""
    cluster = two_nodes
    async with platform.robot("r4") as robot, robot.environment("survivor") as environment:
        echo = await Echo.of(environment)
        await echo.answers()
        (lost,) = [node for node in cluster.nodes if node.name == places(cluster)["survivor"]]
        cluster.kill_kubelet(lost)
        lost.cut_off()
        try:
            await until(lambda: places(cluster).get("survivor") not in (None, lost.name), MOVE_TIMEOUT)
            await echo.answers(MOVE_TIMEOUT)
        finally:
            lost.plug_in()
            cluster.start_kubelet(lost)
        await until(lambda: not environments_on(lost), MOVE_TIMEOUT)
        await echo.answers()


def environments_on(node: Any) -> list[str]:
    """Return the containers of environments on a node, which its Docker knows."""
    return [each["Id"] for each in node.api().containers(filters={"name": "k8s_environment"})]


def test_manifests_are_applied_and_their_programs_are_started(two_nodes: Cluster) -> None:
    """Kubernetes admits all objects and makes their pods, which wait for images that no registry here has."""
    values = Values(
        namespace="rce-applied", databasePassword="a", robotToken="b", containerToken="c", namespacePerUser="true"
    )
    items = [*manifests(values), *rights_per_user(values)]
    text = json.dumps({"apiVersion": "v1", "kind": "List", "items": items})
    try:
        two_nodes.kubectl("apply", "--filename=-", given=text)
        two_nodes.kubectl("apply", "--filename=-", given=text)
        made = {each["metadata"]["name"] for each in two_nodes.get("deployments", namespace="rce-applied")}
        assert made == {"rce-database", "rce-master", "rce-robot", "rce-tasks"}
        for verb, kind, answer in (
            ("create", "namespaces", "yes"),
            ("create", "pods", "yes"),
            ("delete", "nodes", "no"),
        ):
            account = "--as=system:serviceaccount:rce-applied:rce-tasks"
            assert two_nodes.kubectl("auth", "can-i", verb, kind, account, check=False).strip() == answer
    finally:
        two_nodes.kubectl("delete", "--filename=-", "--wait=false", given=text)
