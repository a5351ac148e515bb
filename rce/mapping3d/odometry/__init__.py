"""Front end of the mapper, which runs on a robot: the motion of the camera, and key frames.

- `pyramid`: an image with depth at several sizes, prepared for alignment.
- `alignment`: the pose between two images from their colours and depths; `kernels` has its inner loop.
- `tracker`: poses of frames against key frames, choice of key frames, loss of track.
- `recovery`: the pose between two frames from features, where the predicted motion is far off.
"""
