"""Repeater: level control of transponders, power control of stations, two bands."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from analyzer_sim.world.payload.effects import FaultFlag
from analyzer_sim.world.payload.repeater import level_control_db, power_control_db
from analyzer_sim.world.scenario.events import DownlinkRain, Step, SwitchOff, UplinkRain
from analyzer_sim.world.scenario.scenario import RepeaterSettings, Scenario
from analyzer_sim.world.world import World

SHORT = Scenario("short", "for tests", quiet_h=1.0, alignment_h=0.75, operation_h=8.0)
ALC = RepeaterSettings(alc_transponders=("Ku3",))
UPC = RepeaterSettings(power_controlled=("c04",))
MEMBERS = [8, 9, 10, 11]
OTHERS = [k for k in range(16) if k not in MEMBERS]


@cache
def built(figures: RepeaterSettings, *faults: object, plan: str = "ku16") -> World:
    return World(replace(SHORT, repeater=figures, faults=faults, plan=plan), 1)


def at(world: World, hour: float) -> int:
    return int(np.searchsorted(world.rows.epochs_us, world.scenario.operation_start_us + hour * 3.6e9))


def test_level_control_holds_the_sum() -> None:
    levels = np.array([-43.0, -44.0, -42.0])
    arriving = levels + np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, -1.0, 0.5]])
    gain = level_control_db(arriving, levels, np.ones((3, 3), dtype=bool), [0, 1, 2])
    held = np.sum(10.0 ** ((arriving + gain[:, None]) / 10.0), axis=1)
    np.testing.assert_allclose(held, np.sum(10.0 ** (levels / 10.0)), rtol=1e-12)  # rounding
    assert gain[1] == pytest.approx(-1.0, abs=1e-12)


def test_level_control_of_a_silent_transponder_does_nothing() -> None:
    levels = np.array([-43.0, -44.0])
    assert level_control_db(levels[None, :], levels, np.zeros((1, 2), dtype=bool), [0, 1]).tolist() == [0.0]


def test_a_step_of_one_member_moves_the_others_of_its_transponder() -> None:
    step = Step("step", 1, ("c11",), (2.0, 2.0), (2.0, 2.0))
    stepped, plain = built(ALC, step).rows, built(ALC).rows
    change_db = (stepped.carrier_dbm - plain.carrier_dbm)[at(built(ALC), 3.0)]
    sign = np.sign(change_db[11])
    assert np.all(sign * change_db[[8, 9, 10]] < -0.2)  # one of four users by 2 dB moves the sum by 0.4 to 0.7 dB
    assert np.ptp(change_db[[8, 9, 10]]) < 1e-9  # one gain, rounding
    assert stepped.carrier_dbm[:, OTHERS].tobytes() == plain.carrier_dbm[:, OTHERS].tobytes()
    assert np.any(stepped.flags[:, 8] & FaultFlag.LEVEL_CONTROL)


def test_a_member_off_the_air_lifts_the_others() -> None:
    off = SwitchOff("off", ("c10",), (2.0, 2.0), (2.0, 2.0))
    change_db = (built(ALC, off).rows.carrier_dbm - built(ALC).rows.carrier_dbm)[at(built(ALC), 3.0)]
    assert np.all((change_db[[8, 9, 11]] > 0.7) & (change_db[[8, 9, 11]] < 2.0))  # a quarter of the power: 1.2 dB


def test_power_control_takes_rain_away_from_its_carrier_alone() -> None:
    rain = UplinkRain("rain", 1, ("c04",), (2.0, 2.0), (3.0, 3.0), (0.05, 0.05), (60.0, 60.0))
    wet, dry = built(UPC, rain).rows, built(UPC).rows
    left_db = (wet.carrier_dbm - dry.carrier_dbm)[at(built(UPC), 3.2) : at(built(UPC), 3.9), 4]
    assert abs(float(left_db.mean())) < 0.15  # of 3 dB; what is left is the breath of the rain
    others = [k for k in range(16) if k != 4]
    assert wet.carrier_dbm[:, others].tobytes() == dry.carrier_dbm[:, others].tobytes()
    assert np.any(wet.flags[:, 4] & FaultFlag.POWER_CONTROL)


def test_power_control_ends_at_its_limit() -> None:
    added = power_control_db(np.full(100, -20.0), 60.0, 300.0, 6.0)
    assert added[0] == 0.0
    assert added[-1] == 6.0


def test_power_control_also_hides_the_attitude() -> None:
    free, steered = built(RepeaterSettings()).rows, built(UPC).rows
    rows = slice(at(built(UPC), -8.6), at(built(UPC), -1.0))  # the turns
    assert steered.carrier_dbm[rows, 4].std() < 0.6 * free.carrier_dbm[rows, 4].std()


def test_rain_over_the_site_fades_the_c_band_by_a_tenth() -> None:
    rain = DownlinkRain("rain", (2.0, 2.0), (3.0, 3.0), (0.3, 0.3), (60.0, 60.0))
    wet, dry = built(RepeaterSettings(), rain, plan="kuc16"), built(RepeaterSettings(), plan="kuc16")
    row = at(wet, 2.5)
    fade_db = (dry.rows.carrier_dbm - wet.rows.carrier_dbm)[row] / wet.rows.downlink_fade_db[row]
    bands = [carrier.band for carrier in wet.plan.carriers]
    np.testing.assert_allclose(fade_db, [1.0 if band == "Ku" else 0.1 for band in bands], rtol=1e-9)  # rounding
    assert bands.count("Ku") == bands.count("C") == 8


def test_a_shower_over_a_c_band_station_is_a_tenth_too() -> None:
    rain = UplinkRain("rain", 1, ("c12",), (2.0, 2.0), (3.0, 3.0), (0.3, 0.3), (60.0, 60.0))
    fade_db = built(RepeaterSettings(), rain, plan="kuc16").rows.uplink_fade_db[:, 12]
    assert 0.25 < fade_db.max() < 0.4  # 3 dB in Ku, breath of 6 %
