"""Options in the URL of a client of Foxglove."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any
from urllib.parse import parse_qs

import pytest

from endpoints.gateways.foxglove.options import Options, parse
from rce.errors import InvalidRequest
from rce.protocol.messages import Decimation, Delivery


def request(query: str) -> Any:
    return SimpleNamespace(peer="tcp4:127.0.0.1:1", headers={}, params=parse_qs(query, keep_blank_values=True))


def test_without_options_messages_are_whole() -> None:
    options = parse(request("userID=ann&key=x"))
    assert options.codecs == ()
    assert {options.delivery(type) for type in ("sensor_msgs/Image", "std_msgs/msg/String")} == {Delivery()}
    assert Options().delivery("sensor_msgs/Image") == Delivery()


def test_images_clouds_and_scans_are_reduced() -> None:
    options = parse(request("rate=5&step=2&size=640x480"))
    assert options.delivery("sensor_msgs/Image") == Delivery(rate=5, decimate=Decimation(2, (640, 480)))
    for type in ("sensor_msgs/msg/PointCloud2", "sensor_msgs/LaserScan"):
        assert options.delivery(type) == Delivery(rate=5, decimate=Decimation(2))
    assert options.delivery("tf2_msgs/TFMessage") == Delivery(), "of transforms every message counts"


def test_codecs_are_a_list() -> None:
    pytest.importorskip("av", reason="needs PyAV: pip install '.[video]'")
    pytest.importorskip("DracoPy", reason="needs DracoPy: pip install '.[draco]'")
    assert parse(request("codec=h264,draco")).codecs == ("h264", "draco")
    assert parse(request("codec=h264&codec=draco")).codecs == ("h264", "draco")
    assert parse(request("codec=")).codecs == ()


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("rate=fast", "rate"),
        ("rate=-1", "rate"),
        ("step=0", "step"),
        ("step=2&step=3", "step must be given at most once"),
        ("size=640", "WIDTHxHEIGHT"),
        ("size=0x0", "size"),
        ("codec=quantised", "no codec 'quantised' for viewers: h264, av1, vp9, draco"),
    ],
)
def test_wrong_option_is_refused_by_name(query: str, message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        parse(request(query))
