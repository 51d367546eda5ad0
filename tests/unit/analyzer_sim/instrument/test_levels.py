"""Blocks and lists of numbers."""

import numpy as np
import pytest

from analyzer_sim.instrument.levels import ENCODERS, UNITS, ascii_list, definite_block, real32_block


@pytest.mark.parametrize("length", [0, 9, 10, 99, 100, 128004])
def test_block_header_tells_the_length(length: int) -> None:
    block = definite_block(bytes(length))
    digits = int(block[1:2])
    assert int(block[2 : 2 + digits]) == length
    assert len(block) == 2 + digits + length


def test_block_of_numbers_has_the_byte_order_asked_for() -> None:
    values = np.array([1.0, -42.5])
    assert np.array_equal(np.frombuffer(real32_block(values, is_big_endian=False)[3:], "<f4"), values)
    assert np.array_equal(np.frombuffer(real32_block(values, is_big_endian=True)[3:], ">f4"), values)


def test_list_has_no_blanks_and_no_trailing_comma() -> None:
    assert ascii_list(np.array([-1.0, 2.0, 3.5])) == "-1.000000E+00,2.000000E+00,3.500000E+00"


@pytest.mark.parametrize(
    ("key", "kind", "scale"), [("REAL,32", "f4", 1.0), ("REAL,64", "f8", 1.0), ("INT,32", "i4", 1e-3)]
)
@pytest.mark.parametrize(("is_big_endian", "order"), [(True, ">"), (False, "<")])
def test_every_encoder_has_its_type_and_byte_order(
    key: str, kind: str, scale: float, is_big_endian: bool, order: str
) -> None:
    values = np.array([-42.5, 0.001, 17.0])
    block = ENCODERS[key](values, is_big_endian=is_big_endian)
    np.testing.assert_allclose(scale * np.frombuffer(block[4:], order + kind), values, rtol=1e-7, atol=1e-9)


def test_integers_beyond_32_bits_stand_at_the_limit() -> None:
    block = ENCODERS["INT,32"](np.array([1e12, -1e12]), is_big_endian=False)
    assert np.frombuffer(block[3:], "<i4").tolist() == [2**31 - 1, -(2**31)]


def test_units_of_voltage_and_current_follow_from_50_ohm() -> None:
    level = np.array([13.0103])  # 1 V
    for unit, value in (("V", 1.0), ("DBV", 0.0), ("DBMV", 60.0), ("DBUV", 120.0), ("A", 0.02), ("DBMA", 26.02)):
        assert UNITS[unit](level)[0] == pytest.approx(value, abs=1e-3)
