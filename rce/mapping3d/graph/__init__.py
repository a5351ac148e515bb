"""Back end of the mapper: one map of the key frames of one robot or of several.

- `pose_graph`: poses of key frames and the motions measured between them; least squares.
- `store`: images of key frames, compressed, in a file that is removed with the process.
- `views`: key frames prepared for alignment, the most recent in memory.
- `mapper`: adds key frames to the graph, closes loops, joins robots.
- `trajectory`: poses of all frames from the poses of key frames.
"""
