"""ROS 2 node that sends messages and service requests back.

Each argument is `TOPIC:KIND`, a topic whose messages are published on `TOPIC_back`, or `NAME:service`, a service that
answers with the string of the request. The kinds are those of `lean.TOPICS`.
"""

from __future__ import annotations

import sys

from lean import DEPTH, SERVICE, TOPICS, LeanNode, run


class EchoNode(LeanNode):
    """Node with an echo for each topic and service on the command line."""

    def __init__(self, words: list[str]) -> None:
        """Create the topics and services of the arguments."""
        super().__init__("echo")
        for word in words:
            name, _, kind = word.partition(":")
            if kind == "service":
                self.create_service(SERVICE, name, _echo_request)
            else:
                back = self.create_publisher(TOPICS[kind], f"{name}_back", DEPTH)
                self.create_subscription(TOPICS[kind], name, back.publish, DEPTH)


def _echo_request(request: SERVICE.Request, response: SERVICE.Response) -> SERVICE.Response:
    response.success = True
    response.message = request.load_namespace
    return response


if __name__ == "__main__":
    sys.exit(run(EchoNode))
