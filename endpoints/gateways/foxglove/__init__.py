"""Foxglove: the WebSocket protocol `foxglove.websocket.v1`, now `foxglove.sdk.v1` (https://github.com/foxglove/ws-protocol).

Messages and services are CDR in both directions, which passes untouched; clients may send JSON too.
"""
