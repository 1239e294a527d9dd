"""`VELOCITY_ROBOTS`: theta vectors that were published, their sources, and what is odd of each.

Published robots by name; ``source`` says where theta comes from, and what is odd of it.

Of the ten, only that of the RobuLAB-10 obeys the inequalities of the model: `VelocityRobot.problems` says
which ones others break. It is likely of most that what breaks them is noise: coupling and losses are so
small that a log of a minute cannot tell them from none, as `identify_velocity` says of such a log. Sizes are
about those of the robots, for what is drawn. No limits of commands and accelerations were published.

A Pioneer 3-DX is there three times, with time constants of 0.22, 0.26 and 0.56 s: a theta is that of a
robot as it was loaded and tuned when its log was made. Whoever compares with one says which.

Original papers of the model, and of a controller that adapts theta, which were not read for this:
C. De La Cruz and R. Carelli, Robotica 26, 2008;
F. N. Martins, W. C. Celeste, R. Carelli, M. Sarcinelli-Filho and T. F. Bastos-Filho, Control Engineering
Practice 16, 2008, doi 10.1016/j.conengprac.2008.03.004.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from pinmobile.identification.velocity_robot import VelocityRobot

_Numbers = tuple[float, ...]
_Size = tuple[float, float, float]
_LIBRARY = "F. N. Martins, Simulink library DiffSteer_model.slx (MathWorks File Exchange 44850)"


def _robot(
    of: str, theta: _Numbers, odd: str, *, source: str = _LIBRARY, size: _Size = (0.45, 0.38, 0.24)
) -> VelocityRobot:
    """Return a published robot.

    Parameters
    ----------
    of : str
        Which robot.
    theta : tuple of 6 float
        As it was published.
    odd : str
        What is odd of it beside the inequalities that it breaks.
    source : str
        Where theta was published.
    size : tuple of 3 float
        About that of the robot [m].

    Returns
    -------
    robot : VelocityRobot
        Its `source` states robot, publication, oddities and problems.
    """
    said = f"{of}; {source}", odd, *VelocityRobot(theta).problems
    return VelocityRobot(theta, size=size, source=". ".join(said))


VELOCITY_ROBOTS: Mapping[str, VelocityRobot] = MappingProxyType(
    {
        "pioneer_3dx_laser": _robot(
            "Pioneer 3-DX with a SICK laser scanner",
            (0.2604, 0.2509, -0.000499, 0.9965, 0.00263, 1.0768),
            "Of many public files that have it, four have theta_3 with the other sign. theta_3 "
            "and theta_5 are as small as their standard errors of a log of a minute",
        ),
        "pioneer_3dx": _robot(
            "Pioneer 3-DX without the scanner",
            (0.5338, 0.2168, -0.0134, 0.9560, -0.0843, 1.0590),
            "Its time constant of the speed is twice that of the heavier one with the scanner: "
            "firmware's gains differ, and theta is that of a log, not of a type",
            source=f"{_LIBRARY}; Martins and Brandao 2018, doi 10.5772/intechopen.79397",
        ),
        "pioneer_3dx_laut": _robot(
            "Pioneer 3-DX, called Laut 2011 there",
            (0.2183, 0.1918, -0.0050, 0.9993, -0.0279, 1.0142),
            "It is the third theta of one type of robot",
        ),
        "pioneer_2": _robot(
            "Pioneer 2 without a computer on board",
            (0.1992, 0.13736, 0.001954, 0.9907, 0.01554, 0.9866),
            "With a computer on board its inertias are half as large again and twice as large",
        ),
        "pioneer_2_computer": _robot(
            "Pioneer 2 with a computer on board",
            (0.3037, 0.2768, -0.0004018, 0.9835, 0.003818, 1.0725),
            "theta_3 and theta_5 are as small as their standard errors of a log of a minute",
        ),
        "wheelchair_55kg": _robot(
            "A wheelchair with a person of 55 kg",
            (0.3759, 0.0188, 0.0128, 1.0027, -0.0015, 0.9808),
            "It turns twenty times as promptly as it moves ahead",
            size=(1.1, 0.65, 0.9),
        ),
        "wheelchair_125kg": _robot(
            "A wheelchair with a person of 125 kg",
            (0.4263, 0.0289, 0.0058, 0.9883, 0.0134, 0.9931),
            "It turns fifteen times as promptly as it moves ahead",
            size=(1.1, 0.65, 0.9),
        ),
        "khepera_3": _robot(
            "Khepera III",
            (0.0228, 0.0568, -0.0001, 1.0030, 0.0732, 0.9981),
            "Its time constants are 23 and 57 ms: simulate it with samples, or substeps, of 20 ms and less",
            size=(0.13, 0.13, 0.07),
        ),
        "robulab_10": _robot(
            "RobuLAB-10, called Shojaei 2011 there",
            (6.06, 0.284, 0.54, 6.48, 1.26, 1.8),
            "It comes to 15 % of a speed and 56 % of a yaw rate that are commanded: its input is "
            "another than the speed that it should have",
            size=(0.45, 0.40, 0.30),
        ),
        "agilex_limo": _robot(
            "AgileX LIMO",
            (0.1521, 0.0953, 0.0031, 0.9840, -0.0451, 1.6422),
            "It comes to 61 % of a yaw rate that is commanded",
            source="a public course project, of which no primary source was found",
            size=(0.32, 0.22, 0.25),
        ),
    }
)
