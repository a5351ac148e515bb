#!/usr/bin/env python3
"""ROS 2 node of one robot: answers its queries, labels, with the newest detection of each as JSON, or `null`."""

import contextlib
import json
import os

import psycopg
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String

QUERY = "SELECT x, y FROM detections WHERE label = %s ORDER BY id DESC LIMIT 1"


class Reader(Node):
    """The node, with its connection to the database."""

    def __init__(self, database: psycopg.Connection) -> None:
        super().__init__("reader")
        self._database = database
        self._answers = self.create_publisher(String, "answers", 10)
        self.create_subscription(String, "queries", self._receive, 10)

    def _receive(self, message: String) -> None:
        row = self._database.execute(QUERY, (message.data,)).fetchone()
        answer = None if row is None else {"label": message.data, "x": row[0], "y": row[1]}
        self._answers.publish(String(data=json.dumps(answer)))


rclpy.init()
with (
    psycopg.connect(os.environ["DATABASE_URL"], autocommit=True) as database,
    contextlib.suppress(KeyboardInterrupt, ExternalShutdownException),
):
    rclpy.spin(Reader(database))
