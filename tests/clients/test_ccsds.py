"""Messages that the service writes, read by ``ccsds-ndm-py``: the standard's reader of other people finds the archive.

Files are made by the service's own Python (``write_messages.py``); nothing of the service is imported here, and
rotations are computed here once more.
"""

from collections import defaultdict
from typing import Any

import numpy as np
import pytest
from ccsds_ndm import Aem, Tdm

GOLDEN = (0.056482, 0.209807, -0.912091, 0.347679)
OVERRANGE = 4


def microseconds(epoch: str) -> int:
    """Return an epoch without zone as microseconds UTC."""
    return int(np.datetime64(epoch.removesuffix("Z"), "us").astype(np.int64))


def turn(axis: int, angle_deg: float) -> Any:
    """Return the matrix that turns a frame about one of its axes."""
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    matrix = np.eye(3)
    one, other = (axis + 1) % 3, (axis + 2) % 3
    matrix[one, one] = matrix[other, other] = cosine
    matrix[one, other], matrix[other, one] = sine, -sine
    return matrix


def matrix_of(q1: float, q2: float, q3: float, qc: float) -> Any:
    """Return the matrix of a frame rotation by the formula of the Green Book."""
    return np.array(
        [
            [q1 * q1 - q2 * q2 - q3 * q3 + qc * qc, 2 * (q1 * q2 + q3 * qc), 2 * (q1 * q3 - q2 * qc)],
            [2 * (q1 * q2 - q3 * qc), -q1 * q1 + q2 * q2 - q3 * q3 + qc * qc, 2 * (q2 * q3 + q1 * qc)],
            [2 * (q1 * q3 + q2 * qc), 2 * (q2 * q3 - q1 * qc), -q1 * q1 - q2 * q2 + q3 * q3 + qc * qc],
        ]
    )


def test_attitude(written: Any) -> None:
    message = Aem.from_file(str(written.folder / "attitude.aem"))
    message.validate()
    wanted = {row["epoch_us"]: row["attitude_deg"] for row in written.archive["attitude"]}
    wanted = {epoch: angles for epoch, angles in wanted.items() if None not in angles}
    found: dict[int, Any] = {}
    for segment in message.segments:
        meta = segment.metadata
        assert (meta.ref_frame_a, meta.ref_frame_b) == ("LVLH_ROTATING", "SC_BODY_1")
        assert (meta.object_id, meta.attitude_type, meta.time_system) == ("2003-053B", "QUATERNION", "UTC")
        epochs = [microseconds(epoch) for epoch in segment.data.attitude_states_epochs]
        assert (microseconds(meta.start_time), microseconds(meta.stop_time)) == (epochs[0], epochs[-1])
        quaternions = np.asarray(segment.data.attitude_states_numpy)
        assert np.allclose(np.linalg.norm(quaternions, axis=1), 1.0, atol=1e-9, rtol=0)
        # nobody may interpolate through the sphere or over a gap
        assert np.all(np.sum(quaternions[1:] * quaternions[:-1], axis=1) > 0)
        assert np.all(np.diff(epochs) < 26_000_000)
        found |= dict(zip(epochs, quaternions, strict=True))
    assert len(message.segments) > 2
    assert set(found) == set(wanted)
    for epoch, quaternion in found.items():
        yaw, roll, pitch = wanted[epoch]
        body_from_nadir = turn(0, roll) @ turn(1, pitch) @ turn(2, yaw)
        # twelve decimals of a quaternion
        assert np.abs(matrix_of(*quaternion) - body_from_nadir).max() < 1e-11


def test_golden_quaternion(written: Any) -> None:
    (segment,) = Aem.from_file(str(written.folder / "golden.aem")).segments
    (quaternion,) = np.asarray(segment.data.attitude_states_numpy)
    assert quaternion == pytest.approx(GOLDEN, abs=1e-6)
    zxz = turn(2, -144.066452) @ turn(0, 25.098268) @ turn(2, 5.798977)
    assert np.abs(matrix_of(*quaternion) - zxz).max() < 3e-6


def test_a_day_of_seconds(written: Any) -> None:
    (segment,) = Aem.from_file(str(written.folder / "day.aem")).segments
    assert len(segment.data.attitude_states_epochs) == 86_400
    seconds = written.archive["seconds_of_a_day"]
    print(f"written in {seconds:.2f} s")
    # asked: 1 s on a quiet machine
    assert seconds < 2.0


def test_powers(written: Any) -> None:
    message = Tdm.from_file(str(written.folder / "powers.tdm"))
    message.validate()
    powers: dict[tuple[str, str], dict[int, float]] = defaultdict(dict)
    ratios: dict[tuple[str, str], dict[int, float]] = defaultdict(dict)
    quality: dict[tuple[str, str, int], str] = {}
    for segment in message.body.segments:
        meta = segment.metadata
        source, carrier = meta.track_id.split("/")
        reported = set()
        for each in segment.data.observations:
            epoch = microseconds(each.epoch)
            kept = powers if each.keyword == "CARRIER_POWER" else ratios
            assert epoch not in kept[source, carrier], "a keyword stands twice at one epoch"
            kept[source, carrier][epoch] = each.value
            quality[source, carrier, epoch] = meta.data_quality
            reported.add(each.keyword)
        assert set(meta.data_types.split(",")) == reported
    rows = written.archive["powers"]
    assert {source for source, _ in powers} == {"sa-1", "sa-2"}
    for row in rows:
        for k, power_dbm in enumerate(row["power_dbm"]):
            key, epoch = (row["source"], f"c{k:02d}"), row["epoch_us"]
            if power_dbm is None:
                assert epoch not in powers[key]
                continue
            # the archive keeps float32: dBW + 30 names the same one
            assert np.float32(powers[key][epoch] + 30.0) == np.float32(power_dbm)
            ratio = None if row["c_n0_db_hz"] is None else row["c_n0_db_hz"][k]
            assert ratios[key].get(epoch) == (None if ratio is None else pytest.approx(ratio, abs=1e-5))
            wanted = "RAW" if row["flags"] is None else "DEGRADED" if row["flags"][k] & OVERRANGE else "VALIDATED"
            assert quality[(*key, epoch)] == wanted
    assert sum(map(len, powers.values())) == sum(level is not None for row in rows for level in row["power_dbm"])
