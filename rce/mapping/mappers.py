"""The mappers by the names under which users choose them."""

from __future__ import annotations

from rce.mapping.graph_mapper import GraphMapper
from rce.mapping.particle_mapper import ParticleMapper

AnyMapper = GraphMapper | ParticleMapper
MAPPERS: dict[str, type[GraphMapper] | type[ParticleMapper]] = {"graph": GraphMapper, "particle": ParticleMapper}
