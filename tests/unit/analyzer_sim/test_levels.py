"""Blocks and lists of numbers."""

import numpy as np
import pytest

from analyzer_sim.levels import ascii_list, definite_block, real32_block


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
