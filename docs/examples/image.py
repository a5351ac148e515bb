"""Send images from one robot to another; on the way they are PNG files.

Run it beside `rce up --dev`. It needs numpy and Pillow, which `provisioning/provision demo` installs (elsewhere
`pip install -e '.[images]'` in a checkout):

    python docs/examples/image.py [URL]

Both robots are in one program here to keep it short. `format="jpeg"` makes the files smaller.
"""

import asyncio
import sys

import numpy as np

from rce.client import Robot
from rce.client.images import decode, encode

URL = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:9000/"


async def main() -> None:
    camera_robot = Robot(URL, user="testUser", robot="camera", password="testUser")
    viewer_robot = Robot(URL, user="testUser", robot="viewer", password="testUser")
    async with camera_robot, viewer_robot:
        camera = await camera_robot.publisher("picture", "sensor_msgs/Image", format="png")
        viewer = await viewer_robot.subscriber("picture", "sensor_msgs/Image", format="png", to="camera/picture")

        picture = np.zeros((480, 640, 3), np.uint8)  # height, width, RGB
        picture[:, :320] = (255, 0, 0)
        await camera.publish(encode(picture))

        received = decode(await viewer.get(timeout=10))
        print(f"received {received.shape[1]} x {received.shape[0]} pixels; the first is {received[0, 0].tolist()}")
        assert (received == picture).all()


asyncio.run(main())
