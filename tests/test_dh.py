from math import pi
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from pinmobile import InvalidArgument
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE, DHRow, DHTable, JointType, transform

# Every entry is a sum of few products of cosines and lengths: some roundings of numbers up to 100.
ROUNDING = 1e-13
lengths, angles = st.floats(-100, 100), st.floats(-20, 20)


@given(lengths, lengths, angles)
def test_lecture_transforms_are_those_on_the_slide(y: float, x: float, psi: float) -> None:
    c, s = np.cos(psi), np.sin(psi)
    T01, T12, T23 = LECTURE_TABLE.transforms([y, x, psi])
    expected: list[Any] = [
        [[0, 1, 0, 0], [0, 0, 1, y], [1, 0, 0, 0], [0, 0, 0, 1]],
        [[0, -1, 0, 0], [0, 0, 1, x], [-1, 0, 0, 0], [0, 0, 0, 1]],
        [[-s, -c, 0, 0], [0, 0, -1, 0], [c, -s, 0, 0], [0, 0, 0, 1]],
    ]
    np.testing.assert_allclose([T01, T12, T23], expected, atol=ROUNDING)


@pytest.mark.parametrize("table", [LECTURE_TABLE, SLIDE_TABLE])
@given(lengths, lengths, angles)
def test_both_tables_put_the_body_at_x_y_psi(table: DHTable, y: float, x: float, psi: float) -> None:
    c, s = np.cos(psi), np.sin(psi)
    expected = [[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]]
    np.testing.assert_allclose(table.placements([y, x, psi])[-1], expected, atol=ROUNDING)


def test_the_tables_differ_in_their_intermediate_frames() -> None:
    q = [0.3, -0.2, 0.9]
    difference = np.abs(LECTURE_TABLE.placements(q) - SLIDE_TABLE.placements(q)).max(axis=(1, 2))
    assert difference[1] > 0.5
    assert difference[2] < ROUNDING


@given(angles, lengths, angles, lengths)
def test_transform_is_the_product_of_its_four_parts(alpha: float, a: float, theta: float, d: float) -> None:
    def rotation(axis: int, angle: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        T, (i, j) = np.eye(4), [k for k in range(3) if k != axis]
        T[i, i] = T[j, j] = np.cos(angle)
        T[j, i] = np.sin(angle)
        T[i, j] = -T[j, i]
        return T

    along_x, along_z = np.eye(4), np.eye(4)
    along_x[0, 3], along_z[2, 3] = a, d
    expected = rotation(0, alpha) @ along_x @ rotation(2, theta) @ along_z
    np.testing.assert_allclose(transform(alpha, a, theta, d), expected, atol=ROUNDING)


def test_right_angles_leave_exact_zeros() -> None:
    assert set(np.abs(LECTURE_TABLE.transforms([0, 0, 0])).ravel().tolist()) == {0.0, 1.0}


def test_leading_axes_are_many_configurations() -> None:
    q = np.random.default_rng(0).normal(size=(2, 5, 3))
    many = LECTURE_TABLE.placements(q)
    assert many.shape == (2, 5, 3, 4, 4)
    np.testing.assert_array_equal(many[1, 2], LECTURE_TABLE.placements(q[1, 2]))


def test_a_table_refuses_what_is_no_table() -> None:
    row = DHRow(0, 0, 0, 0, JointType.REVOLUTE, "one")
    with pytest.raises(InvalidArgument, match="expected one DHRow or more"):
        DHTable(())
    with pytest.raises(InvalidArgument, match="expected distinct names"):
        DHTable((row, row))
    with pytest.raises(InvalidArgument, match="alpha is nan"):
        DHRow(float("nan"), 0, 0, 0, JointType.REVOLUTE, "one")
    with pytest.raises(InvalidArgument, match="expected a JointType"):
        DHRow(0, 0, 0, 0, "revolute", "one")  # type: ignore[arg-type]
    with pytest.raises(InvalidArgument, match=r"q has shape \(2,\), expected \(..., 3\)"):
        LECTURE_TABLE.placements([1, 2])


def test_a_table_can_be_pasted_back() -> None:
    row = DHRow(pi / 2, 0.5, 0, 0.1, JointType.PRISMATIC, "slide")
    names = {"DHRow": DHRow, "DHTable": DHTable, "JointType": JointType}
    assert eval(repr(row).replace("<JointType.PRISMATIC: 'prismatic'>", "JointType.PRISMATIC"), names) == row
