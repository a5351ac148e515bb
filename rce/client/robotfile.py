"""A robot from a file: the JSON of the original `rce-ros`, or the same as YAML.

Environments, parameters, nodes, interfaces and connections are set up in this order. Messages then come out as JSON
lines `{"iTag": …, "type": …, "msg": …}` and go in as lines `{"iTag": …, "msg": …}`; a raw (Forwarder) interface has its
bytes in base64. A request to a service that the robot provides comes with a `msgID`, which the line that answers it
repeats, with `msg` or `error`. At the end parameters are removed and environments destroyed.
"""

from __future__ import annotations

import logging

log = logging.getLogger("rce.client")
