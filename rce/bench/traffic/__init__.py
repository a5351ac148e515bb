"""Benchmark of one Robot endpoint under traffic: thousands of robots that send each other messages, and a flood.

The client library would take more processor time than the endpoint, so the robots here are bare sockets.
"""
