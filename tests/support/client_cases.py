"""The cases that the clients of all languages pass, by one name in each language's program.

Python has a test method of the name (`tests/support/client_contract.py`), JavaScript and C++ have a case of the name
(`tests/js/client_contract.js`, `tests/cpp`).
"""

from __future__ import annotations

PYTHON, JAVASCRIPT, CPP = "python", "javascript", "c++"

CASES = {
    "message is delivered": "A message that one robot publishes reaches the subscriber of another one.",
    "values arrive unchanged": "NaN, infinities, integers of 64 bits and the text NaN are the same at the other end.",
    "callback gets each message once in order": "Also after the callback has failed.",
    "raw bytes of any size arrive unchanged": "With one part, and with several.",
    "small message overtakes large one": "A message of another interface is not delayed by 10 MB or more.",
    "service responses and errors": "Ten calls at once are answered, and the error of a handler reaches the caller.",
    "plain function as handler and timeout of slow service": "A call ends after its timeout.",
    "failed commands raise": "With the class of the error, and the item of several commands.",
    "interface that cannot be connected is removed": "Its name is free again.",
    "without peer publish raises and offer drops": "And `offer` sends once there is a peer.",
    "publisher that does not wait keeps what it should": "None, the newest, or all messages.",
    "old messages are dropped and the rate is kept": "By the delivery of a publisher.",
    "resumed session keeps interfaces and connections": "When the socket of either robot breaks.",
    "new session restores interfaces and connections": "All that were not removed.",
    "connection is back when the other robot is": "The events say waiting, then restored.",
    "new session connects when the other robot is back": "The first attempt is reported as an error.",
    "resumed session connects when the other robot is back": "After the first attempt of the session before failed.",
    "connection to a removed interface is gone": "An event says so.",
    "commands issued while offline are executed": "On the next connection.",
    "service call raises unavailable when socket breaks": "It is not known whether it was executed.",
    "no message is delivered twice across reconnections": "They arrive in their order.",
    "stored messages arrive once and in order": "Of a publisher that stores, also when its socket breaks.",
    "dead line is noticed by the robot's own traffic": "Within seconds, and the session is resumed.",
    "close flushes queued messages and ends readers": "Commands fail afterwards.",
    "name is free after close": "The same robot connects again at once.",
    "name in use is rejected": "Unless the robot waits for it.",
    "restarted robot waits for its name": "It connects when the other one has left.",
    "configure executes commands in order": "The connection of two interfaces that were added before it.",
    "goals end as their server says": "Succeeded, rejected, canceled, aborted, and canceled after a reconnection.",
    "refused robots get the reason": "Wrong password, invalid name, two credentials.",
    "environment is created used and destroyed": "With a parameter and a node, and used again in a new session.",
}
"""Demand of each case, by its name."""

ABSENT: dict[str, dict[str, str]] = {
    PYTHON: {
        "values arrive unchanged": "tests/rce/client and tests/converters test values",
        "dead line is noticed by the robot's own traffic": "tests/e2e/test_bench_network.py cuts lines",
        "goals end as their server says": "tests/e2e/test_actions.py tests goals",
        "refused robots get the reason": "tests/rce/client tests refusals by the fake platform",
        "environment is created used and destroyed": "tests/e2e/test_{real_platform,client_real}.py test environments",
    },
    JAVASCRIPT: {
        "restarted robot waits for its name": "robots do not wait for a name",
    },
    CPP: {
        "old messages are dropped and the rate is kept": "the publishers have no delivery",
        "dead line is noticed by the robot's own traffic": "pings notice it",
        "stored messages arrive once and in order": "the publishers do not wait for acknowledgements",
    },
}
"""Why a language's program lacks a case."""


def expected(language: str) -> set[str]:
    """Return the names of the cases that the program of this language must have."""
    return CASES.keys() - ABSENT[language].keys()
