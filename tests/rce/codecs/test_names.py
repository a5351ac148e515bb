"""The codecs of each message type."""

from __future__ import annotations

import pytest

from rce.codecs import names
from rce.errors import InvalidRequest


def test_codecs_of_images_and_clouds_are_known() -> None:
    names.check("quantised", "sensor_msgs/PointCloud2")
    assert [names.is_series(each) for each in ("h264", "palette", "quantised")] == [True, False, False]


@pytest.mark.parametrize(
    ("codec", "type_name", "reason"),
    [
        ("h265", "sensor_msgs/Image", "it has h264, av1, vp9, palette, ffv1, png"),
        ("h264", "sensor_msgs/msg/PointCloud2", "it has quantised, draco"),
        ("h264", "std_msgs/String", "sensor_msgs/msg/Image, sensor_msgs/msg/PointCloud2, .* have some"),
    ],
)
def test_type_without_a_codec_is_refused_with_those_it_has(codec: str, type_name: str, reason: str) -> None:
    with pytest.raises(InvalidRequest, match=reason):
        names.check(codec, type_name)


def test_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(names, "find_spec", lambda _: None)
    with pytest.raises(InvalidRequest, match="the codec h264 needs the extra `video`"):
        names.check("h264", "sensor_msgs/Image")


def test_video_of_robots_may_stay_packed_and_is_received_as_it_is() -> None:
    names.check("h264", names.FOXGLOVE, receives=False)
    assert not names.is_series("h264", names.FOXGLOVE)
    with pytest.raises(InvalidRequest, match="is video already: leave out the codec"):
        names.check("h264", names.FFMPEG)
