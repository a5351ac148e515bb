"""Recognition of places by their appearance, without training data.

- `features`: points of an image that are found again in another one, with their places in space.
- `index`: which key frames look like an image.
- `verification`: the pose between two images that look alike, or the finding that they only look alike.
"""
