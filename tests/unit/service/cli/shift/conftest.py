"""Documents of a service as the commands of a shift read them."""

from typing import Any

import pytest

AXES = ("yaw", "roll", "pitch")
NOW = "2027-01-15T10:30:00.000000Z"
NO_LIMIT = dict.fromkeys(("angle_deg", "limit_deg", "rate_deg_h", "hours_to_limit"))
WAYS = (("yaw", 0.1, None), ("roll", -0.33, 0.7), ("pitch", None, None))
MOTIONS = [{"axis": axis, "beyond": False, "rate_deg_h": rate, "hours_to_limit": hours} for axis, rate, hours in WAYS]
KNOWN = {"code": "known", "severity": "normal", "axis": None, "known_deg": 0.04, "yaw_known_deg": 0.41}
SITUATION = {**KNOWN, **NO_LIMIT, "axes": MOTIONS}


def attitude(method: str = "robust", **changes: Any) -> dict[str, Any]:
    row = {f"{axis}_deg": value for axis, value in zip(AXES, (0.1, -0.33, 0.02), strict=True)}
    figures = {"sigma_deg": dict.fromkeys(AXES, 0.01), "protection_deg": dict.fromkeys(AXES, 0.1)}
    levels = {"downlink_fade": False, "downlink_fade_db": 0.0, "common_db": 0.0, "residual_rms_db": 0.05}
    state = {"epoch": NOW, "method": method, "status": "ACQUIRED", "inhibitions": [], "carriers_used": 11}
    excluded = [{"carrier": "c03", "reason": "uplink_fade"}]
    return {**row, **figures, **levels, **state, "excluded": excluded, **changes}


def reason(code: str, **changes: Any) -> dict[str, Any]:
    return {"code": code, "text": f"text of {code}", "since": None, "next_step": f"step of {code}", **changes}


def verdict(*reasons: dict[str, Any], allowed: bool = False, state: str = "INHIBITED") -> dict[str, Any]:
    return {"allowed": allowed, "state": state, "reasons": list(reasons), "situation": SITUATION}


def condition(code: str, limit: float, **changes: Any) -> dict[str, Any]:
    return {"code": code, "limit": limit, "value": None, "unit": "deg", "since": None, **changes}


NOTHING_OWED: dict[str, list[int]] = {"open_commands": [], "unreported_commands": []}
CONDITIONS = [condition("beyond_validity", 2.0), condition("protection_level", 0.22)]


def alarm(number: int = 1, **changes: Any) -> dict[str, Any]:
    known = {"condition": "attitude_angle", "thing": "roll", "severity": "warning", "state": "unacknowledged"}
    figures = {"present_value": 0.33, "present_at": NOW, "unit": "deg", "raised_at": NOW, "next_step": "do something"}
    return {"id": number, **known, **figures, "children": [], **changes}


def status(control: dict[str, Any], **changes: Any) -> dict[str, Any]:
    link = {"id": "sa-1", "source": "sa-1", "state": "MEASURE", "warnings": [], "rows_missing": 2, "newest_epoch": NOW}
    times = {"now": NOW, "newest_measurement": NOW, "newest_attitude": NOW, "pending": 0, "method": "robust"}
    return {**times, "control": control, "methods_disagree": False, "advice": [], "links": [link], **changes}


def command(**changes: Any) -> dict[str, Any]:
    angles = {"yaw": 0.0, "roll": -0.0066, "pitch": 0.01}
    pulse = {"start": NOW, "duration_s": 0.1, "yaw_n_m": 0.0, "roll_n_m": -0.002, "pitch_n_m": 0.0}
    texts = {"reason": "roll is off", "purpose": "control", "prepared_by": "Anna", "digest": "7da0f923" * 8}
    return {
        "id": 1,
        "state": "PREPARED",
        "simulated": True,
        "dry_run": False,
        "schedule": [pulse],
        **dict.fromkeys(("prepared_at", "start", "stop", "expires_at"), NOW),
        **texts,
        "gross_impulse_n_m_s": angles,
        "predicted": {"angle_change_deg": angles, "peak_angle_deg": angles},
        "checks": [{"name": "envelope", "ok": True, "detail": ""}],
        **changes,
    }


class FakeService:
    """Client of a service that has the documents above; requests that change something are kept."""

    service_url = "http://127.0.0.1:8000"

    def __init__(self) -> None:
        self.verdict = verdict(reason("not_armed"))
        self.sent: list[Any] = []
        self.alarms = [alarm()]
        self.rows = {"robust": attitude(), "paper": attitude("paper")}
        self.command_document = command()
        limits = {"angle_limit_deg": 0.4, "conditions": CONDITIONS}
        self.control_document = {"state": "TRIPPED", "since": NOW, **limits, **NOTHING_OWED}

    def spacecraft(self, name: str) -> Any:
        return {"id": name, "simulated": True}

    def status(self, _: str) -> Any:
        return status(self.verdict)

    def attitude(self, _: str, method: str | None = None) -> Any:
        return self.rows[method or "robust"]

    def control(self, _: str) -> Any:
        return {**self.control_document, "control": self.verdict}

    def carriers(self, _: str) -> Any:
        station = {"name": "Kazan"}
        known = {"transponder": "C1", "station": station, "enabled": True}
        return {"carriers": [{"id": "c00", **known}, {"id": "c03", **known, "station": None}]}

    def torques(self, _: str) -> Any:
        return {"impulse_n_m_s": dict.fromkeys(AXES, 0.001)}

    def pages(self, _: str) -> Any:
        return iter(self.alarms)

    def command(self, *_: object) -> Any:
        return self.command_document

    def confirm_torques(self, *order: object) -> Any:
        self.sent.append(order)
        return command(state="RELEASED")

    def order_control(self, *order: object) -> Any:
        self.sent.append(order)
        return {**self.control_document, "control": self.verdict}

    def request(self, method: str, path: str, body: Any = None, params: Any = None) -> Any:
        if path.endswith("/samples"):
            series = [{"quantity": each, "max": [0.05, None, 0.3]} for each in params["quantity"]]
            return {
                "epochs": ["2027-01-14T12:00:00Z", "2027-01-15T00:00:00Z", "2027-01-15T10:29:00Z"],
                "series": series,
            }
        self.sent.append((method, path, body))
        return alarm() if path.startswith("/alarms") else {"id": 7, "epoch": NOW, **body}


@pytest.fixture
def documents() -> FakeService:
    return FakeService()
