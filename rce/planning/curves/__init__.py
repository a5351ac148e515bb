"""Shortest curves of bounded curvature between two poses, of arcs and straight lines.

A curve is a list of segments, each a kind (`LEFT`, `STRAIGHT`, `RIGHT`) and a length in multiples of the turning
radius, which for an arc is its angle in radians. A negative length is driven in reverse.
"""
