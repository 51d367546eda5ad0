"""Whatever arrives on the plant's input is a schedule within its limits or is refused, and nothing else happens."""

import json
import math
from contextlib import suppress

from hypothesis import given
from hypothesis import strategies as st

from analyzer_sim.epochs import rfc3339
from analyzer_sim.plant.schedule_lines import ScheduleError, parse_schedule

NOW_US = 1_793_491_200_000_000

scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
documents = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4)
)
starts = st.integers(NOW_US - 10**7, NOW_US + 10**9).map(rfc3339) | scalars
elements = st.fixed_dictionaries(
    {
        "start": starts,
        "duration_s": st.floats(-1.0, 1e5) | scalars,
        **{f"{axis}_n_m": st.floats(-0.06, 0.06) | scalars for axis in ("roll", "pitch", "yaw")},
    }
)
schedules = st.fixed_dictionaries({"schedule": st.lists(elements | documents, max_size=4)})


@given(st.text() | documents.map(json.dumps) | schedules.map(json.dumps))
def test_a_line_is_a_schedule_or_is_refused(text):
    flown = ()
    with suppress(ScheduleError):
        flown = parse_schedule(text, NOW_US).elements
    for element in flown:
        assert NOW_US <= element.start_us < element.stop_us
        assert all(math.isfinite(torque) and abs(torque) <= 0.05 for torque in element.torque_n_m)
