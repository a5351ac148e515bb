"""What nodes find around them."""

from __future__ import annotations

from pathlib import Path

from endpoints.environment.settings import Settings
from endpoints.environment.surroundings import for_nodes


def settings(tmp_path: Path, env: str) -> Settings:
    return Settings("ann/brain", "0" * 32, "t", "tcp:x:1", tmp_path, env=env)


def test_the_users_variables_reach_nodes_and_nothing_of_ours_does(tmp_path: Path) -> None:
    found = for_nodes(settings(tmp_path, '{"MODE": "fast", "LANG": "C"}'), {"RCE_TOKEN": "secret", "LANG": "de_CH"})
    assert (found["MODE"], found["LANG"]) == ("fast", "C")
    assert [name for name in found if name.startswith("RCE_")] == ["RCE_RUN"]


def test_what_the_platform_sets_stays(tmp_path: Path) -> None:
    found = for_nodes(settings(tmp_path, '{"PATH": "/mine"}'), {"PATH": "/bin"})
    assert found["PATH"].endswith(":/bin")
