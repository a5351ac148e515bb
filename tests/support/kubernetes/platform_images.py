"""Images and volumes with which the Helm chart of a platform runs in a cluster of the tests.

The programs are those of this machine, which the pods see by mounts. Helm itself adds these mounts: its option
`--post-renderer` runs this module as a filter of the objects.
"""

from __future__ import annotations

import io
import json
import sys
import tarfile
from pathlib import Path
from typing import Any

import yaml

from provisioning.development import postgresql_program
from tests.support.kubernetes.cluster import Cluster
from tests.support.swarm_nodes import Node, host_mounts

POSTGRESQL = "rce-test/postgresql:1"
POSTGRESQL_USER = 70  # in the official image on Alpine
CLAIMS = ("rce-database", "rce-master", "rce-robot", "rce-tasks")
# What the official image does with these variables.
ENTRYPOINT = """
set -e
export PATH={programs}:/usr/bin LC_ALL=C
if [ ! -e "$PGDATA" ]; then
    printf %s "$POSTGRES_PASSWORD" > /tmp/password
    initdb --encoding=UTF8 --username="$POSTGRES_USER" --pwfile=/tmp/password --auth-host=scram-sha-256
    echo "host all all all scram-sha-256" >> "$PGDATA/pg_hba.conf"
    echo "CREATE DATABASE $POSTGRES_DB" | postgres --single -D "$PGDATA" postgres
fi
exec postgres -D "$PGDATA" -c listen_addresses='*' -c unix_socket_directories=/tmp
"""


def load_postgresql(node: Node) -> None:
    """Import an image of PostgreSQL into a node's daemon."""
    files = {
        "etc/passwd": f"postgres:x:{POSTGRESQL_USER}:{POSTGRESQL_USER}::/tmp:\n",
        "entrypoint.sh": ENTRYPOINT.format(programs=Path(postgresql_program("initdb") or "").parent),
    }
    layer = io.BytesIO()
    with tarfile.open(fileobj=layer, mode="w") as archive:
        shells = tarfile.TarInfo("bin")
        shells.type, shells.linkname = tarfile.SYMTYPE, "usr/bin"
        archive.addfile(shells)
        for name, text in files.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(text.encode())
            entry.mode = 0o644
            archive.addfile(entry, io.BytesIO(text.encode()))
    name, _, tag = POSTGRESQL.partition(":")
    changes = [f"ENTRYPOINT {json.dumps(['/usr/bin/sh', '/entrypoint.sh'])}"]
    node.api().import_image_from_data(layer.getvalue(), repository=name, tag=tag, changes=changes)


def make_volumes(cluster: Cluster, namespace: str, place: Path) -> None:
    """Make a volume for each claim of the chart: a directory that all nodes see."""
    volumes = []
    for claim in CLAIMS:
        directory = place / claim
        directory.mkdir(parents=True)
        directory.chmod(0o777)  # kubelet changes the owner of no such directory
        volumes.append(
            {
                "apiVersion": "v1",
                "kind": "PersistentVolume",
                "metadata": {"name": f"{namespace}-{claim}"},
                "spec": {
                    "capacity": {"storage": "1Gi"},
                    "accessModes": ["ReadWriteOnce"],
                    "hostPath": {"path": str(directory)},
                    "claimRef": {"namespace": namespace, "name": claim},
                },
            }
        )
    text = json.dumps({"apiVersion": "v1", "kind": "List", "items": volumes})
    cluster.kubectl("apply", "--filename=-", given=text)


def with_mounts(each: dict[str, Any]) -> dict[str, Any]:
    """Add the mounts to a Deployment, and to the settings of the task set, which makes pods of its own."""
    if each["kind"] != "Deployment":
        return each
    pod = each["spec"]["template"]["spec"]
    (container,) = pod["containers"]
    for number, path in enumerate(host_mounts()):
        pod["volumes"].append({"name": f"host-{number}", "hostPath": {"path": path}})
        container["volumeMounts"].append({"name": f"host-{number}", "mountPath": path, "readOnly": True})
    if each["metadata"]["name"] == "rce-tasks":
        container["args"].append(f"--mounts={','.join(host_mounts())}")
    return each


if __name__ == "__main__":
    yaml.safe_dump_all([with_mounts(each) for each in yaml.safe_load_all(sys.stdin) if each], sys.stdout)
