"""Exported C beside the library: bits of controllers and plants, single precision, statuses, files."""

import ctypes
import platform
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.cli import main
from pinmobile.controllers import PID
from pinmobile.export import export_c
from pinmobile.identification import VelocityCar
from pinmobile.parts import replace
from pinmobile.wheels import OdometryFeedback
from tests import c_code
from tests.frozen import BODY, CIRCLE, WRONG, branching, by_lapack, loops, table
from tests.quick import every_fifth

DT = 0.003  # [s]; 2,001 samples of the loops with 6 s
LOOPS = {name: (parts, options) for name, parts, options in (*loops(), *by_lapack())}
NOISY = ("noisy", "all")
# Loops with the controllers of others.
AGAIN = (
    *("via", "lissajous", "line", "spline", "semi-implicit", "constant", "sine", "noise"),
    *("viscous", "resistance", "joints", "payload", "all forces"),
    *("PD, matrix", "skid-steer", "differential Coulomb", "LQR on wheels", "ur5, base alone"),
)
DRIVE = pm.WheeledRobot(BODY, table("differential"))
LOOPS |= {
    "odometry": (
        (DRIVE, OdometryFeedback(pm.Backstepping(pm.UnicycleTracking(), DRIVE), DRIVE.table), CIRCLE),
        {},
    ),
    "sampled": ((BODY, pm.controllers.Sampled(PID(WRONG), 5), CIRCLE), {}),
    "observed": ((BODY, pm.controllers.DisturbanceObserver(PID(WRONG), WRONG), CIRCLE), {}),
}
SIZES = (3, 3, 3)
LAW = pm.ComputedTorque(BODY, 4.0, 4.0)


def exported(folder: Path, name: str, **options: Any) -> pm.Rollout:
    """Return a run of a loop whose controller is exported."""
    (plant, controller, trajectory), own = LOOPS[name]
    run = pm.simulate(plant, controller, trajectory, dt=DT, engine=pm.Engine.COMPILED, **own)
    known = trajectory if name.startswith("LQR") else None  # designed along its trajectory
    export_c(controller, plant, folder, dt=DT, trajectory=known, **options)
    return run


def computed(
    folder: Path, run: pm.Rollout, *flags: str, compiler: str = "gcc", driver: str = c_code.CONTROLLER
) -> Any:
    """Return the inputs that exported C computes from the states of a run, and the function that does."""
    plant: Any = run.plant
    drive = c_code.compile_c(folder, driver, (plant.nq, plant.nv, plant.nu), *flags, compiler=compiler)
    reference = np.concatenate(run.reference, axis=1)
    *given, u = c_code.rows(run.t, run.q, run.v, reference, np.zeros_like(run.u))
    assert c_code.call(drive, *given, u) == 0
    return u, drive


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", every_fifth(name for name in LOOPS if name not in (*NOISY, *AGAIN)))
def test_a_controller_has_the_bits_of_the_library(name: str, tmp_path: Path) -> None:
    compiler = c_code.compilers()[0]
    run = exported(tmp_path, name)
    assert computed(tmp_path, run, "-O2", compiler=compiler)[0].tobytes() == run.u.tobytes()
    assert "difference of 64 samples: 0, allowed: 0" in c_code.run_test_program(tmp_path, compiler=compiler)


@pytest.mark.long
@pytest.mark.parametrize("name", ["mecanum Rolling", "ur5"])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_each_compiler_and_optimisation_gives_the_same_bits(name: str, tmp_path: Path) -> None:
    run = exported(tmp_path, name)
    for compiler in c_code.compilers():
        for level in ("-O0", "-O3"):
            found, _ = computed(tmp_path, run, level, "-march=native", compiler=compiler)
            assert found.tobytes() == run.u.tobytes(), (compiler, level)


@pytest.mark.parametrize(("name", "precision"), [("odometry", "double"), ("delayed", "single")])
def test_sanitizers_find_nothing(name: str, precision: str, tmp_path: Path) -> None:
    exported(tmp_path, name, precision=precision)
    c_code.run_test_program(tmp_path, *c_code.SANITIZED, compiler="gcc")


PLANTS = "PD", "differential Rolling", "mecanum Rolling", "mecanum Coulomb", "volts", "commanded"


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", every_fifth([*PLANTS, "ur5", "all forces", "semi-implicit"]))
def test_a_plant_has_the_bits_of_the_library(name: str, tmp_path: Path) -> None:
    compiler = c_code.compilers()[-1]
    (plant, controller, trajectory), own = LOOPS[name]
    run = pm.simulate(plant, controller, trajectory, dt=DT, engine=pm.Engine.COMPILED, **own)
    options = {key: own[key] for key in ("forces", "integrator", "substeps") if key in own}
    export_c(None, plant, tmp_path, dt=DT, trajectory=trajectory, **options)
    drive = c_code.compile_c(tmp_path, c_code.PLANT, (plant.nq, plant.nv, plant.nu), "-O2", compiler=compiler)
    t, u, q, v = c_code.rows(run.t, run.u, np.zeros_like(run.q), np.zeros_like(run.v))
    assert c_code.call(drive, t, u, q, v) == 0
    assert np.array_equal(q, run.q)
    assert np.array_equal(v, run.v)
    c_code.run_test_program(tmp_path, "-O1", compiler=compiler)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_number_that_moves_the_start_of_a_plant_is_tunable_without_a_trajectory(tmp_path: Path) -> None:
    car, turn = VelocityCar(0.4, 0.3, 0.2), pm.Tangent(pm.Circle(2.0, 0.4, 4.0))
    with pytest.raises(pm.InvalidArgument, match="tunable has 'wheelbase', from which the start"):
        export_c(None, car, tmp_path, dt=DT, trajectory=turn, tunable=["wheelbase"])
    export_c(None, car, tmp_path, dt=DT, tunable=["wheelbase"])
    assert "wheelbase" in (tmp_path / "robot.h").read_text()


LOOP_IN_C = """
#include "control.h"
#include "body.h"
int drive(long n, const double *t, const double *r, double *q);
int drive(long n, const double *t, const double *r, double *q)
{
    control_memory control;
    body_memory body;
    control_init(&control);
    body_init(&body);
    for (long k = 0; k < n; ++k) {
        control_reference reference;
        control_real mq[NQ], mv[NV], u[NU];
        body_real applied[NU];
        for (int i = 0; i < 3; ++i) reference.q[i] = (control_real)r[9 * k + i];
        for (int i = 0; i < 3; ++i) reference.v[i] = (control_real)r[9 * k + 3 + i];
        for (int i = 0; i < 3; ++i) reference.a[i] = (control_real)r[9 * k + 6 + i];
        for (int i = 0; i < NQ; ++i) mq[i] = (control_real)(q[NQ * k + i] = body.q[i]);
        for (int i = 0; i < NV; ++i) mv[i] = (control_real)body.v[i];
        if (control_step((control_real)t[k], mq, mv, &reference, &control, u) != CONTROL_OK) return 1;
        for (int i = 0; i < NU; ++i) applied[i] = u[i];
        if (body_step(t[k], applied, &body) != BODY_OK) return 2;
    }
    return 0;
}
"""


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", ["PID", "adaptive", "mecanum Rolling", "observed"])
def test_a_loop_in_c_repeats_the_run(name: str, precision: str, tmp_path: Path) -> None:
    compiler = c_code.compilers()[0]
    (plant, controller, trajectory), own = LOOPS[name]
    run = pm.simulate(plant, controller, trajectory, dt=DT, engine=pm.Engine.COMPILED, **own)
    export_c(controller, plant, tmp_path, dt=DT, name="control", precision=precision)
    export_c(None, plant, tmp_path, dt=DT, trajectory=trajectory, name="body")
    sizes = plant.nq, plant.nv, plant.nu
    sources = ("control.c", "body.c")
    drive = c_code.compile_c(tmp_path, LOOP_IN_C, sizes, "-O2", compiler=compiler, sources=sources)
    t, r, q = c_code.rows(run.t, np.concatenate(run.reference, axis=1), np.zeros_like(run.q))
    assert c_code.call(drive, t, r, q) == 0
    off = np.abs(q - run.q).max() / np.abs(run.q).max()
    rounding = 1e-12 if name == "mecanum Rolling" else 0.0  # the plant's projection
    assert off <= (rounding if precision == "double" else 1e-6)


def test_arguments_that_are_not_finite_or_stale_change_nothing(tmp_path: Path) -> None:
    export_c(PID(BODY), BODY, tmp_path, dt=DT)
    main = """
    #include "robot.h"
    #include <math.h>
    #include <stdio.h>
    #include <string.h>
    #define STEP(t) printf(" %d", robot_step(t, q, v, &reference, &memory, u));
    #define WITH(number, other, usual) number = other; STEP(0.006) number = usual;
    int main(void)
    {
        robot_memory memory, before;
        robot_reference reference = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
        double q[3] = {0.1, 0.2, 0.3}, v[3] = {0, 0, 0}, u[3], same[3];
        robot_init(&memory);
        STEP(0)
        STEP(0.003)
        before = memory;
        memcpy(same, u, sizeof u);
        const double bad[3] = {NAN, INFINITY, -INFINITY};
        for (int i = 0; i < 3; ++i) {
            WITH(q[i], bad[i], 0.1)
            WITH(v[i], bad[i], 0)
            WITH(reference.a[i], bad[i], 0)
            STEP(bad[i])
        }
        v[0] = 1e308;
        WITH(q[0], 1e308, 0) /* the result overflows */
        v[0] = 0;
        STEP(0.003)
        STEP(0.001)
        printf(" %d", memcmp(&before, &memory, sizeof memory) || memcmp(same, u, sizeof u));
        STEP(0.0031)
        return 0;
    }
    """
    said = c_code.run_program(tmp_path, main, "-O2", *c_code.SANITIZED)
    assert said.split() == ["0", "0", *["1"] * 12, "1", "2", "2", "0", "0"]


class Shifting:
    """Controller whose signal is a number of the memory before the sample."""

    def initial_state(self, context: Any) -> Any:
        return np.zeros(3), np.ones(3)

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        return 60.0 * (reference.q - q), (q + 1.0, state[0])

    def signals(self, state: Any) -> Any:
        return {"before": ("m", state[1])}


def test_signals_are_those_of_the_sample(tmp_path: Path) -> None:
    run = pm.simulate(BODY, Shifting(), CIRCLE, dt=DT, engine=pm.Engine.COMPILED)
    export_c(Shifting(), BODY, tmp_path, dt=DT)
    driver = c_code.CONTROLLER.replace(
        "#include <string.h>", "#include <string.h>\nextern double seen[3];\ndouble seen[3];"
    )
    driver = driver.replace(
        "    return 0;", "    memcpy(seen, memory.signals.before, sizeof seen);\n    return 0;"
    )
    u, drive = computed(tmp_path, run, driver=driver)
    assert np.array_equal(u, run.u)
    seen = (ctypes.c_double * 3).in_dll(ctypes.CDLL(drive.library), "seen")
    assert np.array_equal(seen, run.signals["before"].values[-1])


def test_parameters_can_be_tuned_within_their_bounds(tmp_path: Path) -> None:
    law = pm.ComputedTorque(WRONG, (4.0, 5.0, 6.0), 4.0)
    run = pm.simulate(BODY, law, CIRCLE, dt=DT, engine=pm.Engine.COMPILED)
    changed = replace(law, {"kp": np.array([9.0, 8.0, 7.0]), "robot.mass": 28.0, "robot.com": [0.1, 0.0]})
    other = pm.simulate(BODY, changed, CIRCLE, dt=DT, engine=pm.Engine.COMPILED)
    export_c(
        law, BODY, tmp_path, dt=DT, tunable=["kp", "controller.kp", "controller.robot.mass", "robot.com"]
    )
    assert computed(tmp_path, run)[0].tobytes() == run.u.tobytes()
    tune = """
    memory.parameters.kp[0] = 9; memory.parameters.kp[1] = 8; memory.parameters.kp[2] = 7;
    memory.parameters.robot_mass[0] = 28; memory.parameters.robot_com[0] = 0.1;
    """
    driver = c_code.CONTROLLER.replace("init(&memory);", f"init(&memory);{tune}")
    assert np.array_equal(computed(tmp_path, other, driver=driver)[0], other.u)
    main = """
    #include "robot.h"
    #include <math.h>
    #include <stdio.h>
    int main(void)
    {
        robot_parameters own = robot_default;
        printf("%d", robot_are_valid(&own));
        own.robot_mass[0] = 0;
        printf(" %d", robot_are_valid(&own));
        own.robot_mass[0] = NAN;
        printf(" %d", robot_are_valid(&own));
        printf(" %g %g %g", robot_default.kp[2], robot_lower.kp[0], robot_upper.kp[0]);
        printf(" %g\\n", robot_lower.robot_mass[0]);
        return 0;
    }
    """
    assert c_code.run_program(tmp_path, main).split() == ["1", "0", "0", "6", "0", "inf", "0"]


def test_bounds_of_a_gain_apply_to_the_diagonal_of_its_matrix(tmp_path: Path) -> None:
    law = pm.ComputedTorque(BODY, [[4.0, -1.0, 0.0], [-1.0, 4.0, 0.0], [0.0, 0.0, 4.0]], 4.0)
    export_c(law, BODY, tmp_path, dt=DT, trajectory=CIRCLE, tunable=["kp"])
    main = """
    #include "robot.h"
    #include <stdio.h>
    int main(void)
    {
        robot_parameters own = robot_default;
        printf("%d %g %g %g", robot_are_valid(&own), own.kp[1], robot_lower.kp[1], robot_lower.kp[4]);
        own.kp[4] = -1;
        printf(" %d\\n", robot_are_valid(&own));
        return 0;
    }
    """
    assert c_code.run_program(tmp_path, main).split() == ["1", "-1", "-inf", "0", "0"]


def test_a_trajectory_is_a_table_with_interpolation_of_order_5(tmp_path: Path) -> None:
    path = pm.Tangent(pm.Circle(2.0, 0.5, 6.0))
    export_c(LAW, BODY, tmp_path, dt=0.1, trajectory=path)
    main = """
    #include "robot.h"
    #include <stdio.h>
    int main(void)
    {
        robot_reference r;
        for (int k = -10; k < 700; ++k) {
            robot_reference_at(k * 0.01, &r);
            for (int i = 0; i < 3; ++i) printf("%a %a %a ", r.q[i], r.v[i], r.a[i]);
        }
        return 0;
    }
    """
    words = [float.fromhex(word) for word in c_code.run_program(tmp_path, main).split()]
    q, v, a = np.moveaxis(np.array(words).reshape(710, 3, 3), 2, 0)
    t = np.arange(-10, 700) * 0.01
    knots = path(np.minimum(np.arange(61) * 0.1, 6.0))
    for found, expected in zip((q, v, a), knots, strict=True):
        assert found[10:611:10].tobytes() == expected.tobytes()
    inside = path(t[10:611])
    # The error of Hermite's quintic: f^(6) h^6 / 46,080; two orders less for the acceleration.
    bound = 2.0 * 0.5**6 * 0.1**6 / 46080
    assert np.abs(q[10:611] - inside.q).max() < 1.1 * bound + 1e-15
    assert np.abs(v[10:611] - inside.v).max() < 60 * bound / 0.1
    assert np.abs(a[10:611] - inside.a).max() < 2000 * bound / 0.1**2
    assert (q[:10] == q[10]).all()
    assert (q[611:] == q[610]).all()
    assert not v[611:].any()
    assert not a[611:].any()


def unary(name: str) -> Any:
    def law(t: Any, q: Any, v: Any, reference: Any) -> Any:
        positive = np.where(q > 0, q, 1.0)
        return getattr(np, name)(positive if name == "log" else q) + 0.0 * v

    return pm.law(law)


RANGES = {
    **dict.fromkeys(("sin", "cos"), np.linspace(-40, 40, 6003)),
    **dict.fromkeys(("exp", "cosh", "sinh"), np.linspace(-30, 30, 6003)),
    **dict.fromkeys(("expm1", "tanh"), np.r_[np.linspace(-3, 3, 6000), 1e-8, -1e-8, 12.0]),
    "log": np.r_[np.geomspace(1e-37, 1e37, 5998), 1.0, 0.999999, 1.000001, 1e-40, 2.0],
    "log1p": np.r_[np.linspace(-0.9, 5, 6000), 1e-6, -1e-6, 1e10],
    "arctan": np.r_[np.linspace(-4, 4, 6000), 1e6, -1e-6, 100.0],
    **dict.fromkeys(("arcsin", "arccos"), np.linspace(-1, 1, 6003)),
    **dict.fromkeys(("rint", "floor"), np.r_[np.linspace(-9.25, 9.25, 6000), 1e7, -0.5, 2.5]),
}


@pytest.mark.parametrize("name", RANGES)
def test_elementary_functions_of_single_precision(name: str, tmp_path: Path) -> None:
    x = RANGES[name].astype(np.float32).astype(float).reshape(-1, 3)
    export_c(unary(name), BODY, tmp_path, dt=DT, precision="single")
    drive = c_code.compile_c(tmp_path, c_code.CONTROLLER, SIZES, "-O2")
    n = len(x)
    *given, u = c_code.rows(np.arange(n), x, 0 * x, np.zeros((n, 9)), 0 * x, kind=np.float32)
    assert c_code.call(drive, *given, u) == 0
    expected = getattr(np, name)(x)
    # A few units of the last place; near zeros of sine and cosine, of the argument's reduction.
    scale = np.maximum(np.abs(expected), 1.0 if name in ("sin", "cos", "arccos", "arcsin") else 1e-6)
    assert (np.abs(u - expected) / scale).max() < 4e-7


def test_the_readme_states_memory_and_stack(tmp_path: Path) -> None:
    law = pm.MeasurementDelay(pm.DisturbanceObserver(pm.ComputedTorque(WRONG)), 3)
    export_c(law, BODY, tmp_path, dt=DT, tunable=["kp"], trajectory=CIRCLE)
    text = (tmp_path / "README.md").read_text()
    main = '#include "robot.h"\n#include <stdio.h>\nint main(void) { printf("%zu", sizeof(robot_memory)); }'
    assert f"| memory | {c_code.run_program(tmp_path, main)} bytes for each robot |" in text
    (stack,) = re.findall(r"below ([\d,]+) bytes", text)
    c_code.succeed(tmp_path, ["gcc", *c_code.STRICT, "-O0", "-fstack-usage", "-c", "robot.c"])
    used = [int(line.split("\t")[1]) for line in (tmp_path / "robot.su").read_text().splitlines()]
    assert sum(sorted(used)[-2:]) < int(stack.replace(",", "")) < 3 * max(used)
    symbols = c_code.succeed(tmp_path, ["nm", "robot.o"]).splitlines()
    assert {line.split()[-1] for line in symbols if " U " in line} <= {"sqrt", "fabs"}
    variables = [line for line in symbols if re.search(r" [bBdDC] ", line)]
    assert not variables, "global state"
    header = (tmp_path / "robot.h").read_text()
    for each in ("q[2]: psi [rad]", "u[2]: Mz [N m]", "kp: proportional gain [1/s^2]", "disturbance"):
        assert each in header
    robot = pm.WheeledRobot(BODY, pm.WheelTable.differential(0.5, 0.1, motor=pm.Motor(torque_limit=2.5)))
    export_c(pm.law(lambda t, q, v, reference: q[3:]), robot, tmp_path, dt=DT)
    other = (tmp_path / "robot.h").read_text()
    assert "u[0]: left [N m], from -2.5 to 2.5\n" in other


TUNED = "differential --tunable controller.k --name base"


@pytest.mark.parametrize("words", [TUNED, "ur5 --precision single", "mecanum --plant"])
def test_a_command_exports_a_scenario(words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = "base" if "base" in words else "robot"
    assert main(["export", *words.split(), "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert f"wrote {tmp_path}: {name}.c, {name}.h, {name}_test.c" in out
    (command,) = re.findall(r"test it: (cd .*)", out)
    assert ("allowed: 0\n" in c_code.succeed(tmp_path, ["sh", "-c", command])) == ("single" not in words)


def test_the_command_states_its_loop_of_a_grid(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    note = (
        "no effect here: spread, grid, cases of the file; the controller is {}, select another by controller="
    )
    for word, kind in (("", "ComputedTorque"), ("controller=PD(kp=9,kd=9)", "PD")):
        assert (
            main(["export", "rivals", "trajectory.path.duration=1", *word.split(), f"--out={tmp_path}"]) == 0
        )
        assert note.format(kind) in capsys.readouterr().out


def test_cmake_builds_and_runs_the_test(tmp_path: Path) -> None:
    if shutil.which("cmake") is None:
        pytest.skip("cmake is not installed")
    export_c(LAW, BODY, tmp_path, dt=DT, name="base_1")
    words = "cmake -B build", "cmake --build build", "ctest --test-dir build"
    c_code.succeed(tmp_path, *(command.split() for command in words))


def test_cxx_reads_the_header(tmp_path: Path) -> None:
    if shutil.which("g++") is None:
        pytest.skip("g++ is not installed")
    export_c(LAW, BODY, tmp_path, dt=DT, trajectory=CIRCLE, tunable=["kp"], precision="single")
    assert "#define ROBOT_DT 0.003f /*" in (tmp_path / "robot.h").read_text()
    (tmp_path / "use.cpp").write_text(
        '#include "robot.h"\ndouble dt = ROBOT_DT;\nint main() { robot_memory m; robot_init(&m); }\n'
    )
    linked = ["g++", "-std=c++11", "-Wall", "-Wpedantic", "-Werror", "use.cpp", "robot.o", "-lm"]
    c_code.succeed(tmp_path, ["gcc", *c_code.STRICT, "-c", "robot.c"], linked)


@pytest.mark.parametrize(
    ("law", "options", "message"),
    [
        (pm.law(branching), {}, r"controller cannot be exported: branching, .*; use np.where"),
        (pm.MPC(BODY), {"trajectory": CIRCLE, "dt": 0.01}, r"controller cannot be exported: .*MPC"),
        (pm.LQR(BODY), {}, r"reads the reference of its context, which is not known; give its trajectory"),
        (LOOPS["noisy"][0][1], {}, "controller draws measurement noise, .*expected a controller"),
        (LAW, {"tunable": ["kq"]}, "unknown parameter in tunable 'kq', did you mean|available: kp"),
        (pm.LQR(BODY), {"tunable": ["input_weight"], "trajectory": CIRCLE}, "tunable has 'input_weight'"),
        (
            pm.PDGravity(BODY, 60.0, 60.0),
            {"tunable": ["robot.yaw_inertia"]},
            "tunable has 'controller.robot.yaw_inertia', which no operation of the law uses, expected",
        ),
    ],
)
def test_what_cannot_be_exported_is_refused(law: Any, options: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises((pm.InvalidArgument, pm.PinmobileError), match=message):
        export_c(law, BODY, tmp_path, **{"dt": DT, **options})
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(platform.machine() != "x86_64", reason="instructions are those of x86")
def test_no_compiler_fuses_a_product_and_a_sum(tmp_path: Path) -> None:
    exported(tmp_path, "computed torque")
    for compiler in c_code.compilers():
        flags = ["-std=c99", "-ffp-contract=off", "-O3", "-march=x86-64-v3"]
        c_code.succeed(tmp_path, [compiler, *flags, "-S", "robot.c"])
        text = (tmp_path / "robot.s").read_text()
        assert "mulsd" in text
        assert not re.search(r"\bvfn?m(add|sub)", text), compiler


def test_the_hash_follows_the_content(tmp_path: Path) -> None:
    def text(kp: float, folder: str) -> str:
        export_c(pm.PD(kp, 9.0), BODY, tmp_path / folder, dt=DT)
        return (tmp_path / folder / "robot.h").read_text()

    (one,), (other,) = (re.findall('ROBOT_HASH "(.*)"', text(kp, "a")) for kp in (9.0, 9.5))
    assert one != other
    assert text(9.0, "b") == text(9.0, "c")
    assert one in text(9.0, "b")
