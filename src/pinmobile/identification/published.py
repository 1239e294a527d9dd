"""`VELOCITY_ROBOTS`: theta vectors that were published, their sources, and what is odd of each."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from pinmobile.identification.velocity_robot import VelocityRobot

_LIBRARY = "F. N. Martins, Simulink library DiffSteer_model.slx (MathWorks File Exchange 44850)"
_PIONEER, _CHAIR = (0.45, 0.38, 0.24), (1.1, 0.65, 0.9)


def _robot(theta: tuple[float, ...], size: tuple[float, float, float], source: str) -> VelocityRobot:
    plain = VelocityRobot(theta)
    odd = "; ".join(plain.problems)
    return VelocityRobot(theta, size=size, source=f"{source}. {odd or 'It breaks no inequality'}")


VELOCITY_ROBOTS: Mapping[str, VelocityRobot] = MappingProxyType(
    {
        "pioneer_3dx_laser": _robot(
            (0.2604, 0.2509, -0.000499, 0.9965, 0.00263, 1.0768),
            _PIONEER,
            f"Pioneer 3-DX with a SICK laser scanner; {_LIBRARY}, and many public files, of which four "
            "have theta_3 with the other sign. theta_3 and theta_5 are as small as their standard errors "
            "of a log of a minute",
        ),
        "pioneer_3dx": _robot(
            (0.5338, 0.2168, -0.0134, 0.9560, -0.0843, 1.0590),
            _PIONEER,
            f"Pioneer 3-DX without the scanner; {_LIBRARY}; Martins and Brandao 2018, doi "
            "10.5772/intechopen.79397. Its time constant of the speed is twice that of the heavier one "
            "with the scanner: firmware's gains differ, and theta is that of a log, not of a type",
        ),
        "pioneer_3dx_laut": _robot(
            (0.2183, 0.1918, -0.0050, 0.9993, -0.0279, 1.0142),
            _PIONEER,
            f"Pioneer 3-DX, called Laut 2011 there; {_LIBRARY}. The third theta of one type of robot",
        ),
        "pioneer_2": _robot(
            (0.1992, 0.13736, 0.001954, 0.9907, 0.01554, 0.9866),
            _PIONEER,
            f"Pioneer 2 without a computer on board; {_LIBRARY}",
        ),
        "pioneer_2_computer": _robot(
            (0.3037, 0.2768, -0.0004018, 0.9835, 0.003818, 1.0725),
            _PIONEER,
            f"Pioneer 2 with a computer on board; {_LIBRARY}. theta_3 and theta_5 are as small as their "
            "standard errors of a log of a minute",
        ),
        "wheelchair_55kg": _robot(
            (0.3759, 0.0188, 0.0128, 1.0027, -0.0015, 0.9808),
            _CHAIR,
            f"A wheelchair with a person of 55 kg; {_LIBRARY}. It turns twenty times as promptly as it "
            "moves ahead",
        ),
        "wheelchair_125kg": _robot(
            (0.4263, 0.0289, 0.0058, 0.9883, 0.0134, 0.9931),
            _CHAIR,
            f"A wheelchair with a person of 125 kg; {_LIBRARY}. It turns fifteen times as promptly as it "
            "moves ahead",
        ),
        "khepera_3": _robot(
            (0.0228, 0.0568, -0.0001, 1.0030, 0.0732, 0.9981),
            (0.13, 0.13, 0.07),
            f"Khepera III; {_LIBRARY}. Its time constants are 23 and 57 ms: simulate it with samples or "
            "substeps of 20 ms and less",
        ),
        "robulab_10": _robot(
            (6.06, 0.284, 0.54, 6.48, 1.26, 1.8),
            (0.45, 0.40, 0.30),
            f"RobuLAB-10, called Shojaei 2011 there; {_LIBRARY}. It comes to 15 % of a speed and 56 % of "
            "a yaw rate that are commanded: its input is another than the speed that it should have",
        ),
        "agilex_limo": _robot(
            (0.1521, 0.0953, 0.0031, 0.9840, -0.0451, 1.6422),
            (0.32, 0.22, 0.25),
            "AgileX LIMO; a public course project, of which no primary source was found. It comes to 61 "
            "% of a yaw rate that is commanded",
        ),
    }
)
"""Published robots by name; ``source`` says where theta comes from, and what is odd of it.

Of the ten, only that of the RobuLAB-10 obeys the inequalities of the model: `VelocityRobot.problems` says
which ones others break. Sizes are about those of the robots, for what is drawn.
"""
