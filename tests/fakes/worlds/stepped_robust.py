"""The robust method stepped without the chain, on a payload of real places."""

import numpy as np
from geometry_flight import HOUR, MINUTE, START_US, FlightPayload

from service.pipeline.config import ChainConfig
from service.pipeline.estimation.robust.method import initial_state, step_late, take_rows
from service.pipeline.estimation.robust.model import robust_model
from service.pipeline.inputs.knowledge import Knowledge
from service.pipeline.inputs.known_motion import CommandedMotion
from service.records.calibration import CalibrationMethod

CONFIG = ChainConfig()
ALIGNED_US = START_US + HOUR
PAYLOAD = FlightPayload.make()


class Stepped:
    """A model and a state, stepped without the chain."""

    def __init__(self, payload=PAYLOAD, calibration=None, alignment=None, angles=(0.0, 0.0, 0.0), **changes):
        self.payload, self.angles = payload, np.array(angles)
        alignment = alignment or payload.alignment(ALIGNED_US, angles_deg=angles)
        known = {
            "spacecraft": payload.spacecraft(),
            "ephemeris": payload.ephemeris(),
            "active": {CalibrationMethod.GEOMETRY: calibration or payload.calibration()},
            "alignment": alignment,
        }
        self.knowledge = Knowledge(**(known | changes))
        self.model = robust_model(self.knowledge, None, CONFIG)
        self.state = initial_state(self.model, alignment, CommandedMotion(0), CONFIG)

    def step(self, minute, change_db=0.0, *, keeps=True, is_late=False, angles=None, **changes):
        measurement = self.payload.measurement(
            ALIGNED_US + round(minute * MINUTE), self.angles if angles is None else angles, **changes
        )
        power_dbm = measurement.power_dbm + np.asarray(change_db)
        if is_late:
            return step_late(self.state, self.model, measurement, power_dbm)
        (outcome,) = take_rows(
            self.state,
            self.model,
            self.knowledge,
            [measurement],
            power_dbm[None, :],
            is_catch_up=False,
            config=CONFIG,
        )
        if keeps:
            self.state = outcome.state
        return outcome
