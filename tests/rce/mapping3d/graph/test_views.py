from __future__ import annotations

import pytest

from rce.mapping3d.evaluation.room import QVGA
from rce.mapping3d.frames import KeyFrame
from rce.mapping3d.graph import views
from rce.mapping3d.graph.store import KeyFrameStore, pack
from tests.support.rgbd import simulated


def test_views_that_were_not_used_lately_are_read_from_the_store(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(views, "MAX_VIEWS", 2)
    store = KeyFrameStore()
    keep = views.Views(store)
    keys = [KeyFrame(0, number, frame, QVGA) for number, frame in enumerate(simulated(0.1))]
    made = [keep.add(store.add(pack(key)), key) for key in keys]
    assert keep[2] is made[2]
    assert keep[0] is not made[0]
    assert keep[0].key.index == 0
    assert keep[2] is made[2]
    assert keep[1] is not made[1]
