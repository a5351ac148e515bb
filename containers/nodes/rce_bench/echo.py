"""Publishes what it hears: each word of the command line is `TOPIC:KIND`, answered on `TOPIC_back`, or `NAME:service`.

The kinds are those of `lean.TOPICS`; a service answers with the string that it was asked with.
"""

from __future__ import annotations

import sys

from lean import DEPTH, SERVICE, TOPICS, LeanNode, run


class EchoNode(LeanNode):
    def __init__(self, words: list[str]) -> None:
        super().__init__("echo")
        for word in words:
            name, _, kind = word.partition(":")
            if kind == "service":
                self.create_service(SERVICE, name, _answer)
            else:
                back = self.create_publisher(TOPICS[kind], f"{name}_back", DEPTH)
                self.create_subscription(TOPICS[kind], name, back.publish, DEPTH)


def _answer(request: SERVICE.Request, response: SERVICE.Response) -> SERVICE.Response:
    response.success = True
    response.message = request.load_namespace
    return response


if __name__ == "__main__":
    sys.exit(run(EchoNode))
