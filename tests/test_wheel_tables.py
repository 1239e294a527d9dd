"""A wheel table prints its rows, its couplings and what the drive can do."""

from typing import Any

import pytest

import pinmobile as pm
from pinmobile import wheels
from pinmobile.wheels import Wheel, WheelTable

WHEEL: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.005, "yaw_inertia": 0.003}


def test_a_table_tells_what_no_motor_drives() -> None:
    rows = tuple(Wheel(f"wheel {k}", 0.3 - k, 0.2 - k, 0.1, roller=0.0) for k in range(3))
    told = "moves by (forward, left, turn) = (0, 1, 0) while no wheel turns: no motor drives that"
    assert told in str(WheelTable(rows))
    with pytest.raises(pm.InvalidArgument, match="does not determine the body's motion by the rates"):
        pm.WheeledRobot(pm.MobileRobot.box(), WheelTable(rows)).odometry([1.0, 1.0, 1.0])
    assert "no motor" not in str(WheelTable.omni(0.2, 0.05, **WHEEL))


def test_a_table_prints_its_rows_and_the_type_of_the_drive() -> None:
    table = WheelTable.differential(track=0.5, radius=0.1, supports=[(-0.3, 0)], **WHEEL)
    assert str(table).splitlines() == [
        "wheel  x [m]  y [m]  radius [m]  rolls to  steering  rollers at  motor",
        "left   0      0.25   0.1         0 deg     fixed                 yes",
        "right  0      -0.25  0.1         0 deg     fixed                 yes",
        "supports without friction: (-0.3, 0) m",
        *str(table.mobility).splitlines(),
    ]


@pytest.mark.parametrize(
    ("table", "told"),
    [
        (WheelTable.differential(0.5, 0.1, **WHEEL), "type (2, 0), differential"),
        (WheelTable.mecanum(0.5, 0.4, 0.08, **WHEEL), "type (3, 0), omnidirectional"),
        (WheelTable.omni(0.3, 0.05), "type (3, 0), omnidirectional"),
        (WheelTable.swerve([(0.3, 0.1), (-0.3, -0.1)], 0.06), "type (1, 2), two steered axles"),
        (
            WheelTable.car(0.6, 0.4, 0.1),
            "AckermannSteering of front_left, front_right\ntype (1, 1), car-like",
        ),
        (WheelTable.skid_steer(0.5, 0.4, 0.1), "cannot roll without slip: wheels 'front_left'"),
    ],
    ids=["differential", "mecanum", "omni", "swerve", "car", "skid steer"],
)
def test_each_drive_tells_its_type(table: WheelTable, told: str) -> None:
    assert told in str(table)
    assert eval(repr(table), {**vars(wheels), "inf": float("inf")}) == table
