"""Mappers by the names under which users choose them."""

from __future__ import annotations

from rce.mapping.particles.mapper import ParticleMapper
from rce.mapping.pose_graph.mapper import GraphMapper

AnyMapper = GraphMapper | ParticleMapper
MAPPERS: dict[str, type[GraphMapper] | type[ParticleMapper]] = {"graph": GraphMapper, "particle": ParticleMapper}
