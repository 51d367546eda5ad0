"""Every storage keeps the catalogue: what was put comes back equal, versions are kept, changes are journaled."""

import json
from dataclasses import replace

import pytest

from db.encoding.record_codec import decode, encode
from service.errors import ConflictError, NotFoundError
from service.records.catalogue import (
    AxisTorques,
    Carrier,
    ControlSettings,
    Ephemeris,
    FedForwardTorque,
    FlexibleMode,
    Method,
    Onboard,
    Site,
    Spacecraft,
    Station,
    Track,
)
from service.records.inputs import EphemerisChange, PlanChange, SpacecraftChange
from service.records.operations.work import LinkReport

INERTIA = ((4000.0, 1.5, 0.0), (1.5, 2000.0, -0.0), (0.0, 0.0, 4000.1))
CRAFT = Spacecraft(
    "yamal",
    "Ямал",
    90.0,
    Site(55.0, 38.0, "Dolgoprudny", 180.0),
    INERTIA,
    0.05,
    cospar_id="2003-053A",
    modes=(FlexibleMode("roll", 0.6, 0.005, 0.1),),
    onboard=Onboard(
        fed_forward_torque=FedForwardTorque(1_700_000_000_000_001, 86_164.1, sine_n_m=AxisTorques(1e-7, -1e-5))
    ),
    control=ControlSettings(method=Method.PAPER, period_s=3600.0),
)


def test_a_spacecraft_comes_back_equal(storage):
    storage.catalogue.add_spacecraft(CRAFT)
    assert storage.catalogue.spacecraft("yamal") == CRAFT


def test_all_spacecraft_come_in_order_of_id(storage):
    for name in ("b", "c", "a"):
        storage.catalogue.add_spacecraft(replace(CRAFT, id=name))
    assert [record.id for record in storage.catalogue.all_spacecraft()] == ["a", "b", "c"]


def test_a_second_spacecraft_of_the_same_id_is_a_conflict_and_changes_nothing(storage):
    storage.catalogue.add_spacecraft(CRAFT)
    with pytest.raises(ConflictError) as caught:
        storage.catalogue.add_spacecraft(replace(CRAFT, name="other"))
    assert caught.value.code == "spacecraft.exists"
    assert storage.catalogue.spacecraft("yamal") == CRAFT


def test_creation_and_change_of_a_spacecraft_are_journaled(storage):
    changed = replace(CRAFT, name="Yamal 202")
    storage.catalogue.add_spacecraft(CRAFT)
    storage.catalogue.replace_spacecraft(changed)
    assert storage.catalogue.spacecraft("yamal") == changed
    contents = [entry.content for entry in storage.archive.journal("yamal", 0, 10)]
    assert contents == [SpacecraftChange(CRAFT, 1), SpacecraftChange(changed, 2)]


def test_a_plan_put_again_is_the_same_plan_and_a_former_plan_put_again_a_new_one(storage):
    storage.catalogue.add_spacecraft(CRAFT)
    station = Station(55.0, 37.0, "Moscow")
    first = [Carrier("c00", "C", "t1", 3.7e9, 5e6, station, 6.0e9)]
    second = [*first, Carrier("c01", "Ku", "t2", 11.7e9, 5e6, intermediate_hz=1.2e9, enabled=False)]
    put = storage.catalogue.put_plan
    plans = [put("yamal", first, "f"), put("yamal", first, "f"), put("yamal", second, "s"), put("yamal", first, "f")]
    assert [plan.id for plan in plans] == [1, 1, 2, 3]
    assert storage.catalogue.plan("yamal", 2) == plans[2]
    assert storage.catalogue.plan("yamal", 2).carriers == tuple(second)
    assert storage.catalogue.plan("yamal") == plans[3]
    journaled = [entry.content for entry in storage.archive.journal("yamal", 1, 10)]
    assert journaled == [PlanChange(1), PlanChange(2), PlanChange(3)]


def test_every_ephemeris_is_a_new_version(storage):
    storage.catalogue.add_spacecraft(CRAFT)
    nodes = Ephemeris(9, (10, 20, 30), 86_164.1, 5, 35, "nodes", Track((1, 2), (0.1, -0.1), (90.01, 89.99)))
    first = storage.catalogue.put_ephemeris("yamal", nodes)
    second = storage.catalogue.put_ephemeris("yamal", nodes)
    assert (first, second) == (replace(nodes, id=1), replace(nodes, id=2))
    assert storage.catalogue.ephemeris("yamal") == second
    assert storage.catalogue.ephemeris("yamal", 1) == first
    entries = storage.archive.journal("yamal", 1, 10)
    assert [entry.content for entry in entries] == [EphemerisChange(1), EphemerisChange(2)]


@pytest.mark.parametrize(
    ("call", "code"),
    [
        (lambda catalogue: catalogue.spacecraft("none"), "spacecraft.unknown"),
        (lambda catalogue: catalogue.replace_spacecraft(replace(CRAFT, id="none")), "spacecraft.unknown"),
        (lambda catalogue: catalogue.put_plan("none", [], "s"), "spacecraft.unknown"),
        (lambda catalogue: catalogue.plan("yamal"), "plan.none"),
        (lambda catalogue: catalogue.plan("yamal", 1), "plan.unknown"),
        (lambda catalogue: catalogue.ephemeris("yamal"), "ephemeris.none"),
        (lambda catalogue: catalogue.ephemeris("yamal", 1), "ephemeris.unknown"),
    ],
)
def test_what_is_not_there_is_named(storage, call, code):
    storage.catalogue.add_spacecraft(CRAFT)
    with pytest.raises(NotFoundError) as caught:
        call(storage.catalogue)
    assert caught.value.code == code


def test_a_spacecraft_without_rows_is_deleted_and_its_id_is_not_given_again(setting, make):
    catalogue = setting.storage.catalogue
    record = catalogue.spacecraft(setting.id)
    catalogue.delete_spacecraft(setting.id)
    for ask in (catalogue.spacecraft, catalogue.plan, setting.storage.archive.head, catalogue.delete_spacecraft):
        with pytest.raises(NotFoundError) as caught:
            ask(setting.id)
        assert caught.value.code == "spacecraft.unknown"
    assert setting.id not in {each.id for each in catalogue.all_spacecraft()}
    with pytest.raises(ConflictError) as caught:
        catalogue.add_spacecraft(record)
    assert caught.value.code == "spacecraft.exists"


def test_a_row_on_its_way_to_a_spacecraft_that_is_deleted_is_refused_and_never_acknowledged(setting):
    database = setting.storage._database
    key = database.key(setting.id)
    setting.storage.catalogue.delete_spacecraft(setting.id)
    # a process that looked the key up before
    database._keys[setting.id] = key
    with pytest.raises(NotFoundError):
        setting.append([10])


def test_a_spacecraft_with_rows_stays(setting):
    setting.append([10])
    with pytest.raises(ConflictError) as caught:
        setting.storage.catalogue.delete_spacecraft(setting.id)
    assert caught.value.code == "spacecraft.has_rows"
    assert len(setting.rows()) == 1


def test_a_withdrawn_plan_gives_way_to_the_one_before_and_its_number_is_not_given_again(setting, make):
    catalogue = setting.storage.catalogue
    first = catalogue.plan(setting.id)
    wrong = catalogue.put_plan(setting.id, make.carriers[::-1], "wrong")
    catalogue.withdraw_plan(setting.id, wrong.id)
    assert catalogue.plan(setting.id) == first
    # a chain that comes by its entry in the journal still reads it
    assert catalogue.plan(setting.id, wrong.id).is_withdrawn
    entry = setting.storage.archive.journal(setting.id, 0, 99)[-1].content
    assert (entry.plan_id, entry.after_withdrawal_of) == (first.id, wrong.id)
    again = catalogue.put_plan(setting.id, make.carriers[::-1], "wrong")
    assert again.id == wrong.id + 1
    with pytest.raises(NotFoundError) as caught:
        catalogue.withdraw_plan(setting.id, wrong.id)
    assert caught.value.code == "plan.unknown"


def test_a_plan_with_rows_open_or_sealed_or_a_calibration_is_not_withdrawn(setting, make):
    catalogue = setting.storage.catalogue
    setting.append([10])
    later = catalogue.put_plan(setting.id, make.carriers[::-1], "later")
    for _ in range(2):
        with pytest.raises(ConflictError) as caught:
            catalogue.withdraw_plan(setting.id, setting.plan_id)
        assert caught.value.code == "plan.in_use"
        list(setting.storage.archive.seal(setting.id, 1 << 50, 1 << 60))
    setting.plan_id = later.id
    setting.calibrate()
    with pytest.raises(ConflictError):
        catalogue.withdraw_plan(setting.id, later.id)


def test_a_draft_is_deleted_and_what_was_active_is_not(setting):
    results = setting.storage.results
    active = setting.calibrate()
    request = active.request
    draft = results.add_calibration(setting.id, request, setting.plan_id, 1, 5, "engineer")
    with pytest.raises(ConflictError) as caught:
        results.delete_calibration(setting.id, draft.id)
    assert caught.value.code == "calibration.unfinished"
    results.finish_calibration(setting.id, draft.id, None, "no rows")
    results.delete_calibration(setting.id, draft.id)
    with pytest.raises(NotFoundError):
        results.calibration(setting.id, draft.id)
    assert [each.id for each in results.calibrations(setting.id)] == [active.id]
    assert results.add_calibration(setting.id, request, setting.plan_id, 1, 5, "engineer").id == draft.id + 1
    with pytest.raises(ConflictError) as caught:
        results.delete_calibration(setting.id, active.id)
    assert caught.value.code == "calibration.not_draft"


@pytest.mark.parametrize("stated", [(None, None), (True, 0.0), (False, 7e-7)])
def test_what_nobody_knows_of_the_craft_is_not_stored_as_none(storage, stated):
    onboard = Onboard(roll_yaw_coupling=stated[0], residual_torque_n_m=stated[1])
    storage.catalogue.add_spacecraft(replace(CRAFT, onboard=onboard))
    assert storage.catalogue.spacecraft("yamal").onboard == onboard


def test_a_spacecraft_stored_before_the_fields_could_be_unknown_keeps_what_it_was():
    """Stored documents say `true` and 0; the oldest ones have neither field."""
    old = json.loads(encode(CRAFT))
    for name in ("residual_torque_n_m", "roll_yaw_coupling"):
        del old["onboard"][name]
    onboard = decode(Spacecraft, json.dumps(old)).onboard
    assert (onboard.roll_yaw_coupling, onboard.residual_torque_n_m) == (True, 0.0)


def test_whereabouts_move_with_whatever_is_stored(setting):
    storage, seen = setting.storage, []

    def has_moved():
        seen.append(storage.catalogue.whereabouts(setting.id))
        return len(seen) < 2 or seen[-1] != seen[-2]

    assert has_moved()
    setting.append([10])
    assert has_moved()
    assert seen[-1].head == storage.archive.head(setting.id)
    assert seen[-1].sources == storage.archive.sources(setting.id)
    storage.catalogue.replace_spacecraft(replace(storage.catalogue.spacecraft(setting.id), name="another"))
    assert has_moved()
    report = LinkReport("rx", "run", setting.id, "sa-1", "MEASURE", {}, {}, None)
    for at_us in (50, 40):
        storage.links.report([report], at_us)
        assert has_moved()
    storage.links.set_enabled("rx", enabled=False)
    assert has_moved()
    storage.links.request_reset("rx")
    assert has_moved()
    assert not has_moved()
    with pytest.raises(NotFoundError) as caught:
        storage.catalogue.whereabouts("nobody")
    assert caught.value.code == "spacecraft.unknown"
