"""`map` and `job`."""

from __future__ import annotations

from rce.api.map_jobs import MapOptions
from rce.cli import table
from rce.cli.command import parser
from rce.cli.commands.maps import MAPPERS


def test_mappers_are_those_of_the_library() -> None:
    from rce.mapping import mappers  # compiles kernels

    assert set(mappers.MAPPERS) == set(MAPPERS)


def test_options_of_a_job_have_the_defaults_of_the_map_service() -> None:
    args = parser(table.COMMANDS["map submit"]).parse_args(["a.log"])
    assert {field: getattr(args, field) for field in MapOptions.__struct_fields__} == {
        field: getattr(MapOptions(), field) for field in MapOptions.__struct_fields__
    }
