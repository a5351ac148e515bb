from __future__ import annotations

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping3d.graph.pose_graph import Edge
from rce.mapping3d.graph.state import POSE, edge_of, matrix, saved_edge
from tests.support.key_frames import right


def test_edge_is_restored() -> None:
    edge = Edge(1, 2, right(0.3), 5.0 * np.eye(6), loop=True)
    restored = edge_of(saved_edge(edge), 3)
    assert (restored.first, restored.second, restored.loop) == (1, 2, True)
    np.testing.assert_array_equal(restored.relative, edge.relative)
    np.testing.assert_array_equal(restored.information, edge.information)


def test_edge_without_its_node_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="no node"):
        edge_of(saved_edge(Edge(0, 2, np.eye(4), np.eye(6), loop=False)), 2)


def test_matrix_that_is_not_finite_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="not complete"):
        matrix(np.full(16, np.nan).tobytes(), POSE)
