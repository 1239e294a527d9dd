"""Real bases on wheels as small URDFs of our own: their numbers, each with the file that has them."""

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

HALF_PI = "1.5707963267948966"


def inertial(mass: float, at: str = "0 0 0", rpy: str = "0 0 0", moments: str = "1 0 0 1 0 1") -> str:
    """Return an <inertial>; the moments are ixx ixy ixz iyy iyz izz."""
    named = zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), moments.split(), strict=True)
    words = " ".join(f'{name}="{value}"' for name, value in named)
    return f'<inertial><origin xyz="{at}" rpy="{rpy}"/><mass value="{mass}"/><inertia {words}/></inertial>'


def wheels_moments(xx: str, yy: str, zz: str, products: str = "0 0 0") -> str:
    """Return the <inertia> that `inertial` writes of these; products are ixy ixz iyz."""
    xy, xz, yz = products.split()
    return f'<inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/>'


def shape(kind: str, given: str, at: str = "0 0 0", rpy: str = "0 0 0", tag: str = "collision") -> str:
    """Return a <collision> or a <visual>."""
    return f'<{tag}><origin xyz="{at}" rpy="{rpy}"/><geometry><{kind} {given}/></geometry></{tag}>'


def link(name: str, *parts: str) -> str:
    """Return a link."""
    return f'<link name="{name}">{"".join(parts)}</link>'


def joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    at: str = "0 0 0",
    rpy: str = "0 0 0",
    axis: str = "0 1 0",
    limit: str = "",
) -> str:
    """Return a joint."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at}" rpy="{rpy}"/><axis xyz="{axis}"/>{limit}</joint>'
    )


def robot(*parts: str) -> str:
    """Return a URDF."""
    return f'<robot name="base">{"".join(parts)}</robot>'


def wheels(
    parent: str,
    places: Sequence[tuple[float, float, float]],
    radius: float,
    width: float,
    mass: float,
    moments: str,
) -> str:
    """Return wheels as Clearpath writes them: continuous about y, a cylinder turned on its side."""
    rolling = shape("cylinder", f'radius="{radius}" length="{width}"', rpy=f"{HALF_PI} 0 0")
    return "".join(
        link(f"wheel_{k}_link", inertial(mass, moments=moments), rolling)
        + joint(f"wheel_{k}", "continuous", parent, f"wheel_{k}_link", f"{x} {y} {z}")
        for k, (x, y, z) in enumerate(places)
    )


def corners(x: float, y: float, z: float) -> list[tuple[float, float, float]]:
    """Return the places of four wheels."""
    return [(x, y, z), (x, -y, z), (-x, y, z), (-x, -y, z)]


def husky() -> str:
    """husky/husky dff7c81, husky_description/urdf/husky and wheel.urdf.xacro; without decorations."""
    x, y, z = 0.9874, 0.5709, 0.2475
    return robot(
        link(
            "base_link",
            shape("box", f'size="{x} {y} {z / 2}"', f"0 0 {z / 4}"),
            shape("box", f'size="{x * 4 / 5} {y} {z / 2 - 0.02}"', f"0 0 {z * 3 / 4 - 0.01}"),
        ),
        link(
            "inertial_link",
            inertial(
                46.034,
                "-0.00065 -0.085 0.062",
                moments="0.6022 -0.02364 -0.1197 1.7386 -0.001544 2.0296",
            ),
        ),
        joint("inertial_joint", "fixed", "base_link", "inertial_link"),
        wheels(
            "base_link",
            corners(0.256, 0.2854, 0.03282),
            0.1651,
            0.1143,
            2.637,
            "0.02467 0 0 0.04411 0 0.02467",
        ),
    )


def jackal() -> str:
    """jackal/jackal c6ab6ca, jackal_description/urdf/jackal.urdf.xacro; its fenders are only drawn."""
    return robot(
        link("base_link"),
        link(
            "chassis_link",
            inertial(16.523, "0.012 0.002 0.067", moments="0.3136 -0.0008 0.0164 0.3922 -0.0009 0.4485"),
            shape("box", 'size="0.42 0.31 0.184"', "0 0 0.092"),
        ),
        link("fender_link", shape("mesh", 'filename="package://j/jackal-fender.stl"', tag="visual")),
        link("navsat_link", shape("cylinder", 'radius="0.026" length="0.016"', "0 0 0.008", tag="visual")),
        joint("base_joint", "fixed", "base_link", "chassis_link"),
        joint("fender_joint", "fixed", "chassis_link", "fender_link"),
        joint("navsat_joint", "fixed", "chassis_link", "navsat_link", "-0.18 0.126 0.1815"),
        wheels(
            "chassis_link",
            corners(0.131, 0.187795, 0.0345),
            0.098,
            0.04,
            0.477,
            "0.0013 0 0 0.0024 0 0.0013",
        ),
    )


def ridgeback() -> str:
    """ridgeback/ridgeback f38b789, ridgeback.urdf.xacro: a front rocker of +-5 degrees."""
    turned = f"{HALF_PI} 0 {HALF_PI}"
    rocker = inertial(10.267, rpy=turned, moments="0.0288 2.20484e-6 -1.3145e-5 0.4324 1.8944e-3 0.4130")
    rolling = shape("cylinder", 'radius="0.0759" length="0.079"', rpy=f"{HALF_PI} 0 0")
    limit = '<limit lower="-0.08726" upper="0.08726" effort="0" velocity="0"/>'
    sides = [(end, side, sign) for end in ("front", "rear") for side, sign in (("left", 1), ("right", -1))]
    riser = 'size="0.493 0.493 0.055"'
    return robot(
        link("base_link"),
        link(
            "chassis_link",
            inertial(
                165.304,
                "0.012 0.002 0.067",
                turned,
                "4.4744 0.03098 0.003647 7.1624 0.1228 4.6155",
            ),
            shape("mesh", 'filename="body-collision.stl"'),
        ),
        link(
            "riser_link",
            shape("box", riser, "0 0 0.0275", "0 0 0.7853981633974483"),
            shape("box", riser, "0 0 0.0275", "0 0 0.7853981633974483", "visual"),
        ),
        link("axle_link"),
        link("front_rocker_link", rocker),
        link("rear_rocker_link", rocker),
        joint("base_joint", "fixed", "base_link", "chassis_link"),
        joint("riser_joint", "fixed", "chassis_link", "riser_link", "0 0 0.22"),
        joint("axle_joint", "fixed", "chassis_link", "axle_link", "0 0 0.05"),
        joint(
            "front_rocker",
            "revolute",
            "axle_link",
            "front_rocker_link",
            "0.319 0 0",
            axis="1 0 0",
            limit=limit,
        ),
        joint("rear_rocker", "fixed", "axle_link", "rear_rocker_link", "-0.319 0 0"),
        *(
            link(
                f"{end}_{side}_wheel_link",
                inertial(2.3, moments="3.3212e-3 0 0 6.6424e-3 0 3.3212e-3"),
                rolling,
            )
            for end, side, _ in sides
        ),
        *(
            joint(
                f"{end}_{side}_wheel",
                "continuous",
                f"{end}_rocker_link",
                f"{end}_{side}_wheel_link",
                f"0 {sign * 0.2755} 0",
            )
            for end, side, sign in sides
        ),
    )


def turtlebot(model: str) -> str:
    """ROBOTIS-GIT/turtlebot3 da785b7, turtlebot3_description/urdf/turtlebot3_burger.urdf and _waffle.urdf.

    Axles are turned by 1.57 and are along z, casters are boxes, `${namespace}` stays where nobody expands it.
    """
    burger = model == "burger"
    n = "${namespace}"
    y = 0.08 if burger else 0.144
    body = (
        inertial(
            0.82573504,
            moments="2.2124416e-03 -1.2294101e-05 3.4938785e-05 2.1193702e-03 -5.0120904e-06 2.0064271e-03",
        )
        + shape("box", 'size="0.140 0.140 0.143"', "-0.032 0 0.070")
        if burger
        else inertial(
            1.3729096,
            moments="8.7002718e-03 -4.7576583e-05 1.1160499e-04 8.6195418e-03 -3.5422299e-06 1.4612727e-02",
        )
        + shape("box", 'size="0.266 0.266 0.094"', "-0.064 0 0.047")
    )
    wheel = inertial(
        2.8498940e-02,
        moments="1.1175580e-05 -4.2369783e-11 -5.9381719e-09 1.1192413e-05 -1.4400107e-11 2.0712558e-05",
    ) + shape("cylinder", 'length="0.018" radius="0.033"')
    caster = inertial(0.005, moments="0.001 0 0 0.001 0 0.001") + shape(
        "box", 'size="0.030 0.009 0.020"', "0 0.001 0"
    )
    casters = [(-0.081, 0.0)] if burger else [(-0.177, -0.064), (-0.177, 0.064)]
    scan = "-0.032 0 0.172" if burger else "-0.064 0 0.122"
    return robot(
        link(f"{n}base_footprint"),
        link(f"{n}base_link", body),
        joint(f"{n}base_joint", "fixed", f"{n}base_footprint", f"{n}base_link", "0 0 0.010"),
        *(
            link(f"{n}wheel_{side}_link", wheel)
            + joint(
                f"{n}wheel_{side}_joint",
                "continuous",
                f"{n}base_link",
                f"{n}wheel_{side}_link",
                f"0 {sign * y} 0.023",
                "-1.57 0 0",
                "0 0 1",
            )
            for side, sign in (("left", 1), ("right", -1))
        ),
        *(
            link(f"{n}caster_{k}_link", caster)
            + joint(
                f"{n}caster_{k}_joint",
                "fixed",
                f"{n}base_link",
                f"{n}caster_{k}_link",
                f"{at} {across} -0.004",
                "-1.57 0 0",
            )
            for k, (at, across) in enumerate(casters)
        ),
        link(
            f"{n}base_scan",
            inertial(0.114, moments="0.001 0 0 0.001 0 0.001"),
            shape("cylinder", 'length="0.0315" radius="0.055"', "0.015 0 -0.0065"),
        ),
        joint(f"{n}scan_joint", "fixed", f"{n}base_link", f"{n}base_scan", scan),
    )


def dingo() -> str:
    """dingo-cpr/dingo 68806fd, dingo_description/urdf/dingo-d.urdf.xacro: axle 99 mm ahead, a ball behind."""
    x, y = 0.0989838, 0.2160016 + 0.02032 / 2
    return robot(
        link("base_link"),
        link(
            "chassis_link",
            inertial(10.0, moments="0.2216 0 0 0.2458 0 0.4474"),
            shape("mesh", 'filename="diff_chassis_collision.stl"'),
        ),
        link(
            "rear_caster", inertial(0.1, moments="0.001 0 0 0.001 0 0.001"), shape("sphere", 'radius="0.01"')
        ),
        joint("base_joint", "fixed", "base_link", "chassis_link"),
        joint("caster_joint", "fixed", "chassis_link", "rear_caster", "-0.244 0 -0.00674"),
        wheels(
            "chassis_link",
            [(x, y, 0.0345), (x, -y, 0.0345)],
            0.049,
            0.02032,
            0.111,
            "0.0003234 0 0 0.0003234 0 0.00049015",
        ),
    )


def dingo_omni() -> str:
    """dingo-cpr/dingo 68806fd, dingo_description/urdf/dingo-o.urdf.xacro: mecanum wheels."""
    track, width = 0.3708, 0.050
    return robot(
        link("base_link"),
        link(
            "chassis_link",
            inertial(14.0, moments="0.35498 0 0 0.7266 0 1.0553"),
            shape("mesh", 'filename="omni_chassis_collision.stl"'),
        ),
        link("imu_link", inertial(0.001, moments="1e-9 0 0 1e-9 0 1e-9")),
        joint("base_link_joint", "fixed", "base_link", "chassis_link"),
        joint("imu_joint", "fixed", "chassis_link", "imu_link"),
        wheels(
            "chassis_link",
            corners(0.570 / 2, track / 2 + width / 2, 0.035145),
            0.050,
            width,
            0.4,
            "0.0003234 0 0 0.0003234 0 0.0004901",
        ),
    )


def pmb2_on_casters() -> str:
    """pal-robotics/pmb2_robot, pmb2_description/urdf, base 541f78e, wheel 6f4ae06 and caster abfd23b.

    The base of TIAGo, without cover, antennas and sensors. Its main wheels hang on suspensions, its four
    casters on swivels; these have the moment about their axles on another axis.
    """
    casters = [
        (f"caster_{end}_{side}", -0.002 + x, y)
        for end, x in (("front", 0.1715), ("back", -0.1715))
        for side, y in (("left", 0.102), ("right", -0.102))
    ]
    effort = f'<limit effort="6.0" velocity="{1 / 0.0985}"/><dynamics damping="1.0" friction="2.0"/>'
    turning = '<dynamics damping="0.015" friction="0.0"/>'
    moved = '<limit effort="100.0" lower="-0.005" upper="0.005" velocity="1.0"/>'
    back = f"-{HALF_PI} 0 0"
    return robot(
        link("base_footprint"),
        link(
            "base_link",
            inertial(
                28.26649,
                "-0.00000106 0.00000109 0.0000387",
                moments="0.465408937 0.002160024 -0.001760255 0.483193291 -0.000655952 0.550939703",
            ),
        ),
        joint("base_footprint_joint", "fixed", "base_footprint", "base_link", "0 0 0.0985"),
        *(
            link(f"suspension_{side}_link", inertial(10, "0 0 -0.02"))
            + link(
                f"wheel_{side}_link",
                inertial(
                    1.82362,
                    f"0 0 {sign * 0.00207}",
                    moments=f"0.00499743171 {-sign * 4.464e-8} -2.245e-8 0.00499741733 {sign * 1.64e-9} "
                    "0.00839239692",
                ),
                shape("sphere", 'radius="0.0985"'),
            )
            + joint(
                f"suspension_{side}_joint",
                "prismatic",
                "base_link",
                f"suspension_{side}_link",
                axis="0 0 1",
                limit=moved,
            )
            + joint(
                f"wheel_{side}_joint",
                "continuous",
                f"suspension_{side}_link",
                f"wheel_{side}_link",
                f"0 {sign * 0.2022} 0",
                back,
                "0 0 1",
                effort,
            )
            for side, sign in (("left", 1), ("right", -1))
        ),
        *(
            link(
                f"{name}_1_link",
                inertial(
                    0.05144761,
                    "-0.00634599 0.00005347 -0.02037519",
                    moments="0.00001513 -0.00000003 0.00000267 0.00001309 -0.00000005 0.00001198",
                ),
            )
            + link(
                f"{name}_2_link",
                inertial(0.08855784, moments="0.00001075 0 0 0.00001541 0 0.00001075"),
                shape("sphere", 'radius="0.025"'),
            )
            + joint(
                f"{name}_1_joint",
                "continuous",
                "base_link",
                f"{name}_1_link",
                f"{x} {y} -0.0335",
                axis="0 0 1",
                limit=turning,
            )
            + joint(
                f"{name}_2_joint",
                "continuous",
                f"{name}_1_link",
                f"{name}_2_link",
                "-0.016 0 -0.040",
                back,
                "0 0 1",
                turning,
            )
            for name, x, y in casters
        ),
    )


def mp400() -> str:
    """neobotix/neo_simulation2 406d984, robots/mp_400/mp_400.urdf: revolute with limits of 1e16, spheres."""
    wheel = inertial(
        1.82362,
        moments="0.00399743171 4.464e-8 -2.245e-8 0.00399741733 -1.64e-9 0.00739239692",
    ) + shape("sphere", 'radius="0.0765"')
    caster = inertial(
        1.4, moments="0.00499743171 4.464e-8 -2.245e-8 0.00499741733 -1.64e-9 0.00839239692"
    ) + shape("sphere", 'radius="0.038"')
    limit = '<limit effort="1000.0" lower="-1e+16" upper="1e+16" velocity="3.5"/>'
    places = [(x, y) for x in (0.165, -0.220) for y in (0.155, -0.155)]
    return robot(
        link("base_footprint"),
        link(
            "base_link",
            inertial(30, moments="1.71402 0 0 0.8856 0 2.5725"),
            shape("mesh", 'filename="MP-400-BODY.dae"'),
        ),
        joint("base_link_joint", "fixed", "base_footprint", "base_link"),
        *(
            link(f"caster_{k}", caster)
            + joint(f"caster_{k}_joint", "fixed", "base_link", f"caster_{k}", f"{x} {y} 0.036", "0 0 1.57")
            for k, (x, y) in enumerate(places)
        ),
        *(
            link(f"wheel_{k}", wheel)
            + joint(
                f"wheel_{k}_joint",
                "revolute",
                "base_link",
                f"wheel_{k}",
                f"0 {y} 0.074",
                "0 0 1.57",
                "1 0 0",
                limit,
            )
            for k, y in enumerate((-0.26, 0.26))
        ),
    )


def fetch() -> str:
    """fetchrobotics/fetch_ros 9c38de6, robots/fetch.urdf, the base alone: radii only in meshes."""
    return robot(
        link(
            "base_link",
            inertial(70.1294, "-0.0036 0 0.0014", moments="1.225 0.0099 0.0062 1.2853 -0.0034 0.987"),
            shape("mesh", 'filename="base_link_collision.STL"'),
        ),
        *(
            link(
                f"{side}_wheel_link",
                inertial(4.3542, moments="0.0045 0 0 0.005 0 0.0045"),
                shape("mesh", f'filename="{side}_wheel_link_collision.STL"'),
            )
            + joint(
                f"{side}_wheel_joint",
                "continuous",
                "base_link",
                f"{side}_wheel_link",
                f"0.0012914 {y} 0.055325",
                "-6.123E-17 0 0",
                limit='<limit effort="8.85" velocity="17.4"/>',
            )
            for side, y in (("l", 0.18738), ("r", -0.18738))
        ),
    )


def pmb2() -> tuple[str, Path]:
    """Return PMB2, the base of example-robot-data's TIAGo without its torso, and its meshes' folder."""
    from example_robot_data import getModelPath

    inside = Path("tiago_description/robots/tiago_no_hand.urdf")
    folder = Path(getModelPath(str(inside)))
    root = ElementTree.parse(folder / inside).getroot()
    below: dict[str, list[ElementTree.Element]] = {}
    for element in root.findall("joint"):
        below.setdefault(element.find("parent").get("link", ""), []).append(element)  # type: ignore[union-attr]
    waiting = ["torso_fixed_link", "torso_fixed_column_link"]
    gone = set(waiting)
    while waiting:
        for element in below.get(waiting.pop(), []):
            waiting.append(element.find("child").get("link", ""))  # type: ignore[union-attr]
            gone.add(waiting[-1])
    for element in [*root.findall("link"), *root.findall("joint")]:
        child = element.find("child")
        if (element.get("name") if child is None else child.get("link")) in gone:
            root.remove(element)
    return ElementTree.tostring(root, encoding="unicode"), folder.parents[1]
