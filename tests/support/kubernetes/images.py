"""Images that the nodes of a test's cluster have."""

from __future__ import annotations

from rce import __version__
from tests.support.containers.container_world import IMAGE
from tests.support.kubernetes.cluster import PAUSE
from tests.support.swarm_nodes import Node, load_host_image


def load_images(node: Node, stand_in: bytes, *, mapping: bool = False) -> None:
    """Load the program that stands in for an endpoint and for the pause of a pod, and the image of this machine."""
    api = node.api()
    for tag, changes in ((IMAGE, [f"LABEL rce.version={__version__}"]), (PAUSE, ['CMD ["/stand-in"]'])):
        name, _, version = tag.partition(":")
        api.import_image_from_data(stand_in, repository=name, tag=version, changes=changes)
    api.close()
    load_host_image(node, mapping=mapping)
