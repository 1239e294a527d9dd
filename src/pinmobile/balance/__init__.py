"""What the base feels: the arm's reaction, where the ground carries it, and what friction that takes."""

from pinmobile.balance.ground import (
    body_zero_moment_point,
    footprint_of,
    required_friction,
    tip_over_margin,
    zero_moment_point,
)
from pinmobile.balance.motion import Motion, Moving, reaction_wrench
from pinmobile.robot.footprint import checked_footprint, margin_inside, rectangle

__all__ = [
    "Motion",
    "Moving",
    "body_zero_moment_point",
    "checked_footprint",
    "footprint_of",
    "margin_inside",
    "reaction_wrench",
    "rectangle",
    "required_friction",
    "tip_over_margin",
    "zero_moment_point",
]
