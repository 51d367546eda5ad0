"""The picture of the signs is that of the frames: every arrow points where the station goes."""

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from flight_geometry import turned_direction

from service.core.geometry.frames import AntennaDirection

PICTURE = Path(__file__).parents[2] / "docs" / "images" / "sign-convention.svg"
SPACE = "{http://www.w3.org/2000/svg}"
ATTITUDE = {"yaw": (0.5, 0.0, 0.0), "roll": (0.0, 0.5, 0.0), "pitch": (0.0, 0.0, 0.5)}
#: deg per unit of the picture: the Earth's edge is 8.7 deg from nadir
SCALE_DEG = 8.7 / 86.0


def test_each_arrow_points_where_the_station_moves():
    seen = {}
    for panel in ET.parse(PICTURE).getroot().iter(f"{SPACE}g"):  # noqa: S314 our own file
        axis = panel.get("data-axis")
        for line in panel.iter(f"{SPACE}line"):
            x1, y1, x2, y2 = (float(line.get(name)) for name in ("x1", "y1", "x2", "y2"))
            position = AntennaDirection(np.array([SCALE_DEG * x1]), np.array([-SCALE_DEG * y1]))
            turned = turned_direction(position, ATTITUDE[axis])
            moved = np.array(
                [turned.azimuth_deg - position.azimuth_deg, turned.elevation_deg - position.elevation_deg]
            )[:, 0]
            drawn = np.array([x2 - x1, y1 - y2])
            assert drawn @ moved > 0.99 * np.linalg.norm(drawn) * np.linalg.norm(moved), (axis, drawn, moved)
            seen[axis] = seen.get(axis, 0) + 1
    assert seen == {"roll": 3, "pitch": 3, "yaw": 4}
