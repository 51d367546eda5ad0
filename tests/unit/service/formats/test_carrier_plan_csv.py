"""Carrier plans through CSV and back."""

import pytest

from service.errors import InvalidInputError
from service.formats.carrier_plan_csv import COLUMNS, read_carrier_plan, write_carrier_plan
from service.records.catalogue import Carrier, Station

PLAN = (
    Carrier(
        "c00", "Ku", "Ku1", 11200.25e6, 1.25e6, Station(55.5, 37.0, 'A "b", c'), 14250e6, "line\nfeed", "H", 958.2e6
    ),
    Carrier("c01", "C", "C1", 0.1 + 0.2, 5e-324, Station(-1.0, -179.5), 1e12, kind="pilot", enabled=False),
    Carrier("b0", "Ku", "Ku1", 11199e6, 1e3, kind="beacon", uplink_power_control="none", transponder_mode="alc"),
)


def test_what_is_written_reads_back_equal():
    documents = read_carrier_plan(write_carrier_plan(PLAN).encode())
    back = tuple(
        Carrier(
            **{k: v for k, v in document.items() if k != "station"},
            station=Station(**document["station"]) if "station" in document else None,
        )
        for document in documents
    )
    assert back == PLAN


def test_the_file_is_rfc_4180_with_plain_whole_numbers():
    lines = write_carrier_plan(PLAN[2:]).split("\r\n")
    assert lines[0] == ",".join(COLUMNS)
    assert lines[1] == "b0,,,,,Ku,Ku1,,,11199000000,,1000,beacon,none,alc,true"
    assert lines[2] == ""


def test_columns_may_stand_in_any_order_and_blank_lines_do_not_count():
    text = "bandwidth_hz , id,downlink_hz,transponder,band\n\n 1e3 , c0 ,11.2e9,T1,Ku\n,,,,\n"
    assert read_carrier_plan(text.encode()) == [
        {"id": "c0", "band": "Ku", "transponder": "T1", "downlink_hz": 11.2e9, "bandwidth_hz": 1000.0}
    ]


def test_a_half_stated_station_is_passed_on_for_the_interface_to_judge():
    text = "id,band,transponder,downlink_hz,bandwidth_hz,station_name\nc0,Ku,T1,1,1,Dubna\n"
    assert read_carrier_plan(text.encode())[0]["station"] == {"name": "Dubna"}


@pytest.mark.parametrize(
    ("raw", "pointer", "word"),
    [
        (b"", "", "missing"),
        (b"\xc3", "", "UTF-8"),
        (b"id,band,transponder,downlink_hz,bandwidth_hz,power\n", "", "'power'"),
        (b"id,band,transponder,downlink_hz,bandwidth_hz,band\n", "", "twice"),
        (b"id,band,transponder,downlink_hz\n", "", "'bandwidth_hz'"),
        (b"id,band,transponder,downlink_hz,bandwidth_hz\nc0,Ku,T,1\n", "/carriers/0", "4 cells"),
        (b"id,band,transponder,downlink_hz,bandwidth_hz\nc0,Ku,T,1,1\nc1,Ku,T,x,1\n", "/carriers/1/downlink_hz", "'x'"),
        (b'id,band,transponder,downlink_hz,bandwidth_hz\nc0,"Ku,T,1,1\n', "", "CSV"),
        (b"id,band,transponder,downlink_hz,bandwidth_hz\nc0,Ku," + b"x" * 5000 + b",1,1\n", "", "4096"),
        (b"id,band,transponder,downlink_hz,bandwidth_hz\nc0,Ku," + b"x" * 200_000 + b",1,1\n", "", "CSV"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(raw, pointer, word):
    with pytest.raises(InvalidInputError) as caught:
        read_carrier_plan(raw)
    assert caught.value.code == "csv.malformed"
    assert caught.value.fields[0].pointer == pointer
    assert word in caught.value.detail


def test_names_that_a_spreadsheet_would_compute_are_guarded_and_read_back():
    names = ("=HYPERLINK(1)", "+7", "-1", "@sum", "'=1", "''@x", "'quoted'", "O'Brien")
    plan = [
        Carrier(f"c{k}", "Ku", "T", 1e10, 1e6, Station(-1.5, -7.0, name), 1e10, name) for k, name in enumerate(names)
    ]
    text = write_carrier_plan(plan)
    cells = [line.split(",") for line in text.splitlines()[1:]]
    assert [line[1] for line in cells][:5] == ["'=HYPERLINK(1)", "'+7", "'-1", "'@sum", "''=1"]
    # numbers stay numbers
    assert {(line[3], line[4]) for line in cells} == {("-1.5", "-7")}
    documents = read_carrier_plan(text.encode())
    assert [(each["name"], each["station"]["name"]) for each in documents] == [(name, name) for name in names]
