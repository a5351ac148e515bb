"""Gateways: clients of other protocols, which take part in one environment as guests of the platform.

A gateway translates the operations of its protocol; sessions, interfaces, queues and limits are those of robots.
"""
