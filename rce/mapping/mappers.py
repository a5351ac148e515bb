"""Mappers by the names under which users choose them."""

from __future__ import annotations

from rce.mapping.particles.mapper import ParticleMapper
from rce.mapping.pose_graph.hypotheses import HypothesisMapper

AnyMapper = HypothesisMapper | ParticleMapper
MAPPERS: dict[str, type[HypothesisMapper] | type[ParticleMapper]] = {
    "graph": HypothesisMapper,
    "particle": ParticleMapper,
}
