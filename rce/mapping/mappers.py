"""The mappers by the names under which users choose them."""

from __future__ import annotations

from collections.abc import Callable

from rce.mapping.graph_mapper import GraphMapper
from rce.mapping.mapper import Mapper, MapperSettings
from rce.mapping.particle_mapper import ParticleMapper

MAPPERS: dict[str, Callable[[MapperSettings], Mapper]] = {"graph": GraphMapper, "particle": ParticleMapper}
