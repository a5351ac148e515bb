"""`python -P -m containers`: the Container task set of one machine."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

from twisted.internet.base import ReactorBase

from containers.data_relay import DataRelay
from containers.docker.setup import Setup
from containers.engine import Engine, EnvironmentEnded
from containers.process.engine import ProcessEngine
from containers.recordings.receiver import RecordingReceiver
from containers.recordings.store import RecordingStore
from containers.settings import NAMESERVERS, Settings, check_isolation
from containers.taskset import TaskSet
from rce.control.credential import Credential
from rce.errors import InvalidRequest, StartFailed
from rce.net.tls import Tls, load_tls
from rce.process import loop
from rce.process.lock import lock_directory
from rce.process.malloc import return_freed_memory
from rce.process.settings import load_or_exit

PROGRAM = "rce container"


def main() -> int:
    """Run the program; return its exit status."""
    settings = load_or_exit(Settings, PROGRAM)
    os.environ.pop("RCE_TOKEN", None)
    try:
        check_isolation(settings)
    except InvalidRequest as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return 2
    return loop.run(lambda reactor: serve(reactor, settings))


async def serve(reactor: ReactorBase, settings: Settings) -> None:
    """Run the task set that `settings` describe."""
    return_freed_memory()
    directory = settings.data_dir.absolute()
    with lock_directory(directory, "task set"):
        credential = Credential(directory / "container.credential", settings.token)
        tls = load_tls(settings.tls)
        relay = DataRelay(tls)
        store = RecordingStore(directory / "recordings")
        receiver = RecordingReceiver(store)
        task_set = TaskSet(
            reactor,
            settings.master,
            settings.own_name,
            credential,
            lambda ended: make_engine(reactor, settings, relay, receiver, tls, ended),
            directory / "packages",
            relay,
            settings.entry,
            tls,
            (store, receiver),
        )
        try:
            if settings.data_host and settings.engine in ("process", "docker"):
                await relay.listen(settings.data_host, settings.data_port, settings.data_address)
            await task_set.run(stop_environments=settings.stop_environments)
        finally:
            await receiver.close()
            await relay.close()


def make_engine(
    reactor: ReactorBase,
    settings: Settings,
    relay: DataRelay,
    recordings: RecordingReceiver,
    tls: Tls | None,
    ended: Callable[[EnvironmentEnded], None],
) -> Engine:
    """Make the engine that `settings` name.

    Raises:
        InvalidRequest: A directory of the setting `package_path` does not exist.
        StartFailed: The engine needs docker-py, which is not installed.
    """
    directory = settings.data_dir.absolute()
    packages = [os.path.abspath(path) for path in settings.package_path]
    if missing := [path for path in packages if not os.path.isdir(path)]:
        raise InvalidRequest(f"setting package_path: no such directory: {', '.join(missing)}", field="package_path")
    surroundings = {"package_path": ",".join(packages), "typesupport": settings.typesupport}
    if settings.engine == "process":
        return ProcessEngine(
            settings.size,
            settings.features,
            ended,
            root=directory / "environments",
            settings={"master": settings.master, "host": settings.host, **_files(settings.tls), **surroundings},
            relay=relay,
            recordings=recordings,
            packages=directory / "packages",
            warm=settings.warm,
        )
    setup = Setup(
        reactor=reactor,
        platform=settings.own_name,
        directory=directory,
        master=settings.master,
        image=settings.image,
        settings=surroundings,
        tls=tls,
        read_only=[path for path in (*packages, settings.typesupport, *settings.mounts) if path],
    )
    if settings.engine == "kubernetes":
        return make_kubernetes_engine(settings, setup, ended)
    try:
        from containers.docker.engine import DockerEngine
        from containers.swarm.engine import SwarmEngine
        from containers.swarm.spec import AgentService
    except ModuleNotFoundError as error:
        raise StartFailed(
            f"the {settings.engine} engine needs docker-py ({error}): pip install '.[docker]' in a checkout of RCE"
        ) from None
    if settings.engine == "swarm":
        return SwarmEngine(
            settings.size,
            settings.features,
            ended,
            setup,
            agent=AgentService(
                settings.agent_image,
                settings.agent_address,
                settings.data_port,
                settings.entry,
                settings.egress_pool,
                settings.nameservers or NAMESERVERS,
                settings.mounts,
            ),
            keep_agents=not settings.stop_environments,
        )
    return DockerEngine(
        settings.size,
        settings.features,
        ended,
        setup,
        gpus=settings.gpus,
        relay=relay,
        recordings=recordings,
        host=settings.host,
        egress_pool=settings.egress_pool,
        nameservers=settings.nameservers or NAMESERVERS,
    )


def make_kubernetes_engine(settings: Settings, setup: Setup, ended: Callable[[EnvironmentEnded], None]) -> Engine:
    """Make the engine `kubernetes`.

    Raises:
        StartFailed: It needs kubernetes_asyncio, which is not installed.
    """
    try:
        from containers.kubernetes.engine import KubernetesEngine
        from containers.kubernetes.setup import AgentSetup, ClusterSetup
    except ModuleNotFoundError as error:
        raise StartFailed(
            f"the kubernetes engine needs its library ({error}): pip install '.[kubernetes]' in a checkout of RCE"
        ) from None
    agent = AgentSetup(
        image=settings.agent_image,
        address=settings.agent_address,
        port=settings.agent_port,
        data_port=settings.data_port,
        entry=settings.entry,
        mounts=settings.mounts,
    )
    cluster = ClusterSetup(
        agent=agent,
        namespace=settings.namespace,
        per_user=settings.namespace_per_user,
        pull_secrets=settings.pull_secrets,
        priority_class=settings.priority_class,
        nameservers=settings.nameservers or NAMESERVERS,
        directory=settings.node_directory,
        seccomp=settings.seccomp_directory,
    )
    return KubernetesEngine(
        settings.size, settings.features, ended, setup, cluster=cluster, keep_agents=not settings.stop_environments
    )


def _files(tls: Path | None) -> dict[str, str]:
    """Return the setting `tls` for endpoints: they run as this user, who can read the files anyway."""
    return {"tls": str(tls.absolute())} if tls else {}


if __name__ == "__main__":
    sys.exit(main())
