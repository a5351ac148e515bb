"""Recognition in camera images: fiducials, textured objects, and a user's own network.

Pure: images in, detections out. The node around it is in `containers/nodes/rce_recognition`. Frames of cameras are
optical: x to the right, y down, z forward. An object's own frame is that of its printed side: x to the right, y up, z
towards the viewer.
"""
