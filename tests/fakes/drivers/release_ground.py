"""A ground station over HTTP whose spacecraft is calibrated and aligned: what tests of the release start from.

The calibration knows the truth and is laid into the archive before a service opens it; rows, orders and reports go
over sockets. Powers follow the payload's own geometry, so the attitude that the service finds is the one a test
chooses. The spacecraft is simulated and the clock is that of its data: an hour passes as fast as its rows are sent.
"""

from dataclasses import dataclass, replace
from typing import Any

import httpx
import numpy as np
from geometry_flight import HOUR, MINUTE, START_US, FlightPayload, S
from waiting import wait_until as until

from db.storage import SqlStorage
from service.records.catalogue import Spacecraft
from service.records.epoch import format_epoch

PAYLOAD = FlightPayload.make(12)
NOISE_DB = 0.05
#: of the alignment
OPERATION_US = START_US + 2 * HOUR
#: deg, of the manual alignment
SIGMA_DEG = {"yaw": 0.01, "roll": 0.005, "pitch": 0.005}


def seed_archive(url: str, *crafts: Spacecraft) -> None:
    """Lay spacecraft with their catalogue and calibration into an archive."""
    storage = SqlStorage(url)
    storage.prepare()
    calibration = PAYLOAD.calibration()
    for record in crafts:
        storage.catalogue.add_spacecraft(record)
        storage.catalogue.put_plan(record.id, PAYLOAD.carriers(), "sha")
        storage.catalogue.put_ephemeris(record.id, PAYLOAD.ephemeris())
        draft = storage.results.add_calibration(record.id, calibration.request, 1, 1, START_US, "engineer")
        storage.results.finish_calibration(record.id, draft.id, calibration.result, None)
        storage.results.activate_calibration(record.id, draft.id)
    storage.close()


def record(spacecraft_id: str, **changes: Any) -> Spacecraft:
    """Return a simulated spacecraft under ground control by the robust method, released in two steps."""
    return replace(PAYLOAD.spacecraft(), id=spacecraft_id, **changes)


@dataclass
class ReleaseGround:
    """A station and its operators; ``client`` carries an administrator's key."""

    client: httpx.Client
    spacecraft_id: str
    #: instant of the newest row
    now_us: int = OPERATION_US

    @property
    def base(self) -> str:
        """Path of the spacecraft."""
        return f"/api/v1/spacecraft/{self.spacecraft_id}"

    def ask(self, path: str, body: Any = None, key: str | None = None) -> httpx.Response:
        """Send an order below the spacecraft."""
        headers = {} if key is None else {"Authorization": f"Bearer {key}"}
        return self.client.post(f"{self.base}{path}", json=body, headers=headers)

    def post(self, path: str, body: Any = None, *, status: int = 200, key: str | None = None) -> Any:
        """Return what an order is answered that must have this status."""
        answer = self.ask(path, body, key)
        assert answer.status_code == status, f"{path}: {answer.status_code} {answer.text}"
        return answer.json()

    def refused(self, path: str, body: Any = None, key: str | None = None) -> tuple[int, str]:
        """Return status and code of a refusal."""
        answer = self.ask(path, body, key)
        assert answer.status_code >= 400, f"{path}: {answer.text}"
        return answer.status_code, str(answer.json()["code"])

    def get(self, path: str) -> Any:
        """Return a document of the spacecraft."""
        answer = self.client.get(f"{self.base}{path}")
        assert answer.status_code == 200, f"{path}: {answer.text}"
        return answer.json()

    def key(self, name: str, role: str) -> str:
        """Return a new key; one in force under this name is revoked, because names are unique."""
        for key in self.client.get("/api/v1/keys").json()["rows"]:
            if key["name"] == name:
                assert self.client.delete(f"/api/v1/keys/{key['id']}").is_success
        made = self.client.post("/api/v1/keys", json={"name": name, "role": role})
        assert made.status_code == 201, made.text
        return str(made.json()["key"])

    def align(self) -> None:
        """Send half an hour of rows at zero attitude and tie the estimator to it."""
        self.now_us -= 30 * MINUTE
        self.rows(30, settle=False)
        angles = {"yaw_deg": 0.0, "roll_deg": 0.0, "pitch_deg": 0.0, "sigma_deg": SIGMA_DEG}
        self.post("/alignments", {"epoch": self.epoch(), **angles, "source": "manual"}, status=201)

    def rows(self, count: int, angles_deg: Any = (0.0, 0.0, 0.0), change_db: Any = 0.0, *, settle: bool = True) -> None:
        """Send rows of the next minutes at one attitude (3,) or one a row (T, 3): yaw, roll, pitch.

        ``change_db``, which broadcasts with (T, N), is added to the powers; NaN = not measured.
        """
        epochs_us = self.now_us + MINUTE * np.arange(1, count + 1)
        rng = np.random.default_rng(int(epochs_us[0] // S))
        power = PAYLOAD.power_dbm(epochs_us, angles_deg) + change_db
        self.send(epochs_us, power + NOISE_DB * rng.normal(size=power.shape))
        self.now_us = int(epochs_us[-1])
        if settle:
            self.settle()

    def send(self, epochs_us: Any, power_dbm: Any) -> None:
        """Send rows of given powers."""
        rows = [
            {
                "epoch": format_epoch(int(epoch)),
                "power_dbm": [None if np.isnan(value) else value for value in row],
            }
            for epoch, row in zip(epochs_us, np.asarray(power_dbm).tolist(), strict=True)
        ]
        receipt = self.post("/measurements:batch", {"plan_id": 1, "source": "sa-1", "measurements": rows})
        assert receipt["accepted"] == len(rows), receipt

    def settle(self) -> None:
        """Wait until every row has its results."""
        until(lambda: bool(self.get("/status")["pending"] == 0), "rows are computed")

    def epoch(self, ahead_s: float = 0.0) -> str:
        """Return an instant beside the newest row."""
        return format_epoch(self.now_us + round(ahead_s * S))
