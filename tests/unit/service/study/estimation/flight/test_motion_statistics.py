"""Statistics of measured motion are read as the simulator states them."""

import json

import numpy as np

from service.study.estimation.flight.motion_statistics import NOTHING_MEASURED, TrueRates, read_motion_statistics


def test_what_is_not_measured_is_none():
    text = json.dumps({"wheels": None, "rates": None, "polarimeter": None})
    read = read_motion_statistics(text, np.empty(0))
    assert (read.wheels, read.rates, read.polarimeter) == NOTHING_MEASURED[:3] == (None, None, None)


def test_figures_are_read_by_name_and_unknown_ones_are_left_out():
    rates = {"bias_deg_h": 0.01, "bias_tau_h": 8.0, "noise_deg_sqrt_h": 0.003, "bias_factor": 5.0, "colour": "red"}
    text = json.dumps({"wheels": None, "rates": rates, "polarimeter": None})
    read = read_motion_statistics(text, np.empty(0))
    assert read.rates == TrueRates(bias_deg_h=0.01, bias_tau_h=8.0, bias_factor=5.0, noise_deg_sqrt_h=0.003)
