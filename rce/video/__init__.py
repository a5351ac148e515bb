"""Video of colour and of depth, so that a robot's line carries its camera: a few percent of the raw size.

The package needs the extra `video` (PyAV, which bundles FFmpeg, and NumPy). It knows neither messages nor connections.

- `packet`: what travels, and the errors of packets.
- `color`: lossy video of colour images: H.264, AV1 or VP9.
- `depth`: lossless images of depth.
- `rate`: how many bytes a second the line carries now.
"""
