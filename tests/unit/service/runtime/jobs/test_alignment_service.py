"""Alignment from the archive: what it keeps, and every reason to refuse."""

from dataclasses import replace

import numpy as np
import pytest

from service.api.schemas.alignments import AlignmentAnswer
from service.errors import ConflictError, InvalidInputError, NotFoundError
from service.records.calibration import Window
from service.records.catalogue import Onboard
from service.records.levels.attitude import Axes
from service.runtime.jobs.alignment_service import AlignmentRequest

TRACKER = ("star_tracker",) * 3
SIGMA = Axes(0.02, 0.01, 0.01)


@pytest.fixture
def ground(new_ground):
    """A station that is calibrated but not aligned."""
    return new_ground()


def by_hand(at_us, angles=(0.0, 0.0, 0.0), reason=None):
    return AlignmentRequest(None, None, (at_us, Axes(*angles), SIGMA), reason, "approver")


def test_a_window_of_the_star_tracker_gives_angles_and_references(ground):
    found = ground.align()
    assert found.epoch_us == ground.alignment_window.stop_us - ground.synthetic.MINUTE
    np.testing.assert_allclose(found.attitude_deg, 0.0, atol=1e-12)  # the tracker of this day reads zero
    assert (found.calibration_id, found.source, found.created_by) == (1, "star_tracker", "operator")
    assert {item.samples for item in found.references} == {30}
    reference = [item.reference_dbm for item in found.references]
    # mean of thirty rows of 0.05 dB, and the harmonic's own error of two days: six sigma
    np.testing.assert_allclose(reference, ground.payload.level_dbm, atol=0.06)
    assert ground.storage.results.alignments(ground.id) == (found,)


def test_angles_stated_by_hand_take_the_powers_before_them(ground):
    found = ground.aligner.align(ground.id, by_hand(ground.at(0)))
    assert (found.epoch_us, found.source, found.sigma_deg) == (ground.at(0), "manual", SIGMA)
    assert found.window == Window(ground.at(-15), ground.at(0) + 1)
    assert {item.samples for item in found.references} == {16}


@pytest.mark.parametrize("coupling", [True, False, None])
def test_an_exchange_of_roll_and_yaw_that_nobody_stated_is_warned_of(ground, coupling):
    record = ground.storage.catalogue.spacecraft(ground.id)
    ground.storage.catalogue.replace_spacecraft(replace(record, onboard=Onboard(roll_yaw_coupling=coupling)))
    warnings = ground.align().warnings
    assert len(warnings) == (coupling is None)
    assert all("onboard.roll_yaw_coupling" in warning for warning in warnings)
    # it is kept with the alignment, whatever the catalogue says later
    ground.storage.catalogue.replace_spacecraft(replace(record, onboard=Onboard(roll_yaw_coupling=True)))
    assert ground.storage.results.alignments(ground.id)[0].warnings == warnings
    assert AlignmentAnswer.of(ground.storage.results.alignments(ground.id)[0]).warnings == list(warnings)


def test_powers_that_contradict_are_refused_with_what_they_tell_unless_overridden(ground):
    with pytest.raises(ConflictError) as caught:
        ground.aligner.align(ground.id, by_hand(ground.at(0), (0.0, 0.5, -0.5)))
    assert caught.value.code == "alignment.inconsistent"
    assert "roll -0." in caught.value.detail
    assert ground.storage.results.alignments(ground.id) == ()
    forced = ground.aligner.align(ground.id, by_hand(ground.at(0), (0.0, 0.5, -0.5), "sensor was re-mounted"))
    assert forced.override_reason == "sensor was re-mounted"


def refused(ground, request, kind=InvalidInputError):
    with pytest.raises(kind) as caught:
        ground.aligner.align(ground.id, request)
    return caught.value.code, caught.value.detail


def test_a_window_without_references(ground):
    empty = Window(ground.at(100), ground.at(130))
    code, detail = refused(ground, AlignmentRequest(empty, TRACKER, None, None, "operator"))
    assert code == "alignment.no_reference"
    assert detail.startswith("no yaw and roll and pitch of star_tracker between")


def test_a_window_without_powers(ground):
    code, detail = refused(ground, by_hand(ground.at(500)))
    assert code == "alignment.no_powers"
    assert detail.startswith("0 carriers have 8 rows or more between")


def test_neither_a_window_nor_angles(ground):
    code, _ = refused(ground, AlignmentRequest(ground.alignment_window, None, None, None, "operator"))
    assert code == "alignment.shape"


def test_without_an_active_calibration(ground):
    storage = ground.storage
    storage.catalogue.add_spacecraft(
        type(ground.payload.spacecraft())(
            "fresh", "Fresh", 90.0, ground.payload.spacecraft().receiving_site, ground.synthetic.INERTIA, 0.05
        )
    )
    with pytest.raises(ConflictError, match="no calibration of fresh is active"):
        ground.aligner.align("fresh", by_hand(ground.at(0)))
    with pytest.raises(NotFoundError):
        ground.aligner.align("nobody", by_hand(ground.at(0)))
