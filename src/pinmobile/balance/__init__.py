"""What the base feels: the arm's reaction, where the ground carries it, and what friction that takes."""

from pinmobile.balance.footprint import checked_footprint, margin_inside, rectangle
from pinmobile.balance.ground import (
    body_zero_moment_point,
    required_friction,
    tip_over_margin,
    zero_moment_point,
)
from pinmobile.balance.motion import Motion, Moving, reaction_wrench

__all__ = [
    "Motion",
    "Moving",
    "body_zero_moment_point",
    "checked_footprint",
    "margin_inside",
    "reaction_wrench",
    "rectangle",
    "required_friction",
    "tip_over_margin",
    "zero_moment_point",
]
