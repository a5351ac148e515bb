"""Bodies of requests that add interfaces which can be connected."""

from __future__ import annotations

OUT = {
    "endpointTag": "brain",
    "interfaceTag": "out",
    "interfaceType": "SubscriberInterface",
    "className": "std_msgs/String",
    "addr": "/out",
}
IN = OUT | {"endpointTag": "r1", "interfaceTag": "in", "interfaceType": "PublisherConverter", "addr": ""}
