"""Files of a plan."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from rce.planning.costmap import Costmap
from rce.planning.files import write_plan
from tests.support.planning import ROBOT, walled


def test_path_is_written_as_csv_and_as_a_picture(tmp_path: Path) -> None:
    poses = np.array([[2.0, 2.0, 0.0, 1.0], [4.0, 2.0, 0.5, 1.0], [3.5, 2.0, 0.5, -1.0]])
    written = write_plan(tmp_path / "new", walled(), Costmap(walled(), ROBOT), poses)
    assert [path.name for path in written] == ["path.csv", "path.png"]
    assert written[0].read_text().splitlines() == [
        "x,y,theta,direction",
        "2.0000,2.0000,0.00000,1",
        "4.0000,2.0000,0.50000,1",
        "3.5000,2.0000,0.50000,-1",
    ]
    image = cv2.imread(str(written[1]))
    assert image is not None
    assert image.shape == (800, 800, 3)
    assert image[800 - 8 * 20, 8 * 30].tolist() == [200, 90, 20]  # blue at (3, 2)
    assert image[800 - 8 * 10, 8 * 51].max() < 60  # the wall
