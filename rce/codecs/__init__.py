"""Codecs of interfaces: images and clouds as packets, a small part of their size.

Both ends use the package: the Robot endpoint and the client library. It knows arrays and packets; it knows neither
serialized messages nor connections.

- `names`: the codecs that a type has, and what they need.
- `packed`: the messages in which packets travel.
- `images`: colour as video, depth without loss; needs the extra `video`.
- `clouds`: a quantised layout, and Draco, which needs the extra `draco`.
"""
