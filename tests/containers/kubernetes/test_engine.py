"""The engine `kubernetes` with a real cluster of one node: the contract."""

from __future__ import annotations

import pytest

pytest.importorskip("kubernetes_asyncio", reason="needs kubernetes_asyncio: pip install '.[kubernetes]'")
pytest.importorskip("docker", reason="nodes of the tests need docker-py: pip install '.[docker]'")

from tests.support.containers.engine_contract import EngineContract


class TestKubernetesEngine(EngineContract):
    pass
