"""Users to look for, and the further carriers that a recommendation names."""

import numpy as np

from service.core.geometry.frames import station_direction
from service.pipeline.planning.assumed_beams import NOISES, AssumedBeam, assume_payload
from service.pipeline.planning.planning import MOST_FURTHER, Rule, recommend
from service.pipeline.planning.user_sites import offered_sites
from service.records.catalogue import Carrier, Station

BEAMS = {"Ku0": AssumedBeam(-3.0, 7.0, 4.0, 3.0), "Ku1": AssumedBeam(2.0, 7.0, 4.0, 3.0)}


def payload(count=14):
    carriers = tuple(
        Carrier(f"c{k:02d}", "Ku", f"Ku{k % 2}", 11.2e9, 1e6, Station(45.0 + 3.0 * (k % 8), 40.0 + 7.0 * k))
        for k in range(count)
    )
    return assume_payload(carriers, 90.0, NOISES["quiet"], BEAMS)


def test_sites_lie_under_their_beams() -> None:
    known = payload()
    offered = offered_sites(known, known.candidates)
    assert offered.is_usable.all()
    for name, transponder in zip(offered.carrier_ids, offered.transponders, strict=True):
        north, east = name.split()
        latitude = float(north[:-1]) * (1.0 if north.endswith("N") else -1.0)
        longitude = float(east[:-1]) * (1.0 if east.endswith("E") else -1.0)
        seen = station_direction([longitude], [latitude], [0.0], 90.0)
        assert BEAMS[transponder].shape_at(seen.azimuth_deg, seen.elevation_deg).gain_db[0] > -12.0
    assert np.allclose(offered.sigma_db, known.candidates.sigma_db[0])


def test_further_carriers_lower_the_bounds_one_after_the_other() -> None:
    known = payload()
    alone = recommend(known.candidates, 8, Rule.OPTIMAL)
    assert [one.in_plan for one in alone.further] == [True] * MOST_FURTHER
    assert not {one.carrier for one in alone.further} & {
        known.candidates.carrier_ids[k] for k in alone.sets["optimal"].chosen
    }
    offered = recommend(known.candidates, 14, Rule.OPTIMAL, offered=offered_sites(known, known.candidates))
    assert [one.in_plan for one in offered.further] == [False] * MOST_FURTHER
    for one in (*alone.further, *offered.further):
        assert max(one.bound_ratio) <= 1.0 + 1e-9
        assert min(one.bound_ratio) < 0.99


def test_what_is_determined_by_nothing_gets_no_advice() -> None:
    known = payload(3)
    assert recommend(known.candidates, 3, Rule.OPTIMAL).further == ()
