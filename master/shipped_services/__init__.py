"""Services of the catalogue that come with RCE: a declaration each, as users write them (`service.yaml`)."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from msgspec.structs import replace

from master.graph.catalogue import SHIPPED, offer_of
from master.graph.packages import EVERYBODY
from master.graph.state import State
from rce import structfile
from rce.api.views import NewOffer

FOLDER = Path(__file__).parent


def add_to(state: State) -> None:
    """Put the services into the catalogue, in place of those of another version of RCE."""
    for offer in state.offers.by(SHIPPED):
        state.offers.drop(offer.name)
    for declaration, revision in _declarations():
        state.offers.put(replace(offer_of(SHIPPED, declaration, revision), shared=[EVERYBODY]))


@cache
def _declarations() -> list[tuple[NewOffer, str]]:
    """Return each declaration with its revision: instances of the same one are current."""
    paths = sorted(FOLDER.glob("*.yaml"))
    return [(structfile.read(path, NewOffer), hashlib.sha256(path.read_bytes()).hexdigest()[:32]) for path in paths]
