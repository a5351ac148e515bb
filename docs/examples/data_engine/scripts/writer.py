#!/usr/bin/env python3
"""ROS 2 node: writes the detections of all robots, JSON objects with `label`, `x` and `y`, to PostgreSQL."""

import contextlib
import json
import os

import psycopg
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String

TABLE = """CREATE TABLE IF NOT EXISTS detections (
    id bigserial PRIMARY KEY, time timestamptz NOT NULL DEFAULT now(),
    label text NOT NULL, x float8 NOT NULL, y float8 NOT NULL
)"""
LOCK = "SELECT pg_advisory_xact_lock(1)"  # two that create the table at once would disturb each other


class Writer(Node):
    """The node, with its connection to the database."""

    def __init__(self, database: psycopg.Connection) -> None:
        super().__init__("writer")
        self._database = database
        self.create_subscription(String, "/detections", self._receive, 100)

    def _receive(self, message: String) -> None:
        try:
            found = json.loads(message.data)
            row = (str(found["label"]), float(found["x"]), float(found["y"]))
        except (ValueError, TypeError, KeyError) as error:
            self.get_logger().error(f"not a detection: {message.data[:200]!r}: {error!r}")
            return
        self._database.execute("INSERT INTO detections (label, x, y) VALUES (%s, %s, %s)", row)


rclpy.init()
with psycopg.connect(os.environ["DATABASE_URL"], autocommit=True) as database:
    with database.transaction():
        database.execute(LOCK)
        database.execute(TABLE)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Writer(database))
