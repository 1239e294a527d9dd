"""The benchmark of controllers: against published numbers, what it judges, and what it refuses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pinmobile import PD, BenchmarkScenario, Circle, InvalidArgument, SlidingMode, Tangent, benchmark
from pinmobile.benchmarking import NOMINAL, STANDARD, Benchmark, contestants

EACH = {name: one for name, one in contestants().items() if name != "MPC"}
# Largest distance after 5 s [mm], and time until it stays below 20 mm where the force is limited [s].
PLACES = "payload", "push", "noise", "all"
TABLE: dict[str, tuple[str, ...]] = {
    "PD": ("163", "328", "148", "421"),
    "computed torque": ("6.59", "66.5", "7.64", "115"),
    "PID": ("1.91", "17.6", "2.08", "31.7"),
    "adaptive": ("10.4", "54.3", "5.37", "104"),
    "adaptive, friction": ("9.26", "51.0", "2.83", "44.3"),
    "sliding mode": ("0.777", "7.86", "1.82", "6.82"),
    "super-twisting": ("0.021", "6.84", "1.65", "22.9"),
    "observer": ("0.992", "9.13", "2.24", "23.9"),
    "ADRC": ("3.32", "14.1", "1.73", "35.9"),
    "LQR": ("10.4", "41.3", "6.61", "91.4"),
}
SETTLED = {"computed torque": 2.34, "PID": 4.21, "sliding mode": 3.83, "ADRC": 2.27, "LQR": 2.78}
# Where the docstring of `benchmark` says why: 3 % in the payload; what one draw of the noise gives.
OTHERS = {("adaptive, friction", "payload"): 0.035, ("super-twisting", "noise"): 0.4, ("ADRC", "noise"): 0.25}
SHORT = BenchmarkScenario(trajectory=Tangent(Circle(radius=1.5, rate=0.6, duration=2)), after=1.0)


@pytest.fixture(scope="module")
def result() -> Benchmark:
    """Return the scenarios of the table, run."""
    return benchmark(EACH, {name: STANDARD[name] for name in (*PLACES, "limits", "delay")})


@pytest.mark.once
def test_errors_are_those_of_an_independent_implementation(result: Benchmark) -> None:
    for name, row in TABLE.items():
        for place, printed in zip(PLACES, row, strict=True):
            noisy = place in ("noise", "all")  # others were drawn
            share = OTHERS.get((name, place), 0.15 if noisy else 0.02)
            digit = 10.0 ** -len(printed.partition(".")[2])
            found = 1e3 * result.scores[name][place].largest
            assert abs(found - float(printed)) <= max(share * float(printed), 0.5 * digit), (name, place)
    for name, time in SETTLED.items():
        assert result.scores[name]["limits"].recovery == pytest.approx(time, rel=0.02), name


@pytest.mark.once
def test_it_says_who_comes_closest_at_what_price_and_what_latency_costs(result: Benchmark) -> None:
    assert np.isinf(result.scores["PD"]["delay"].largest)
    chatter = dict(zip(result.scores, result.values("chatter")[:, PLACES.index("noise")], strict=True))
    assert chatter["sliding mode"] > 5 * chatter["computed torque"]
    assert "sliding mode in noise (" in result.verdict
    assert "speed times latency, 0.9 m/s x 30 ms" in result.verdict
    assert "Lost: PD in delay (diverges); adaptive, friction in limits (10.2 m off)" in result.verdict


def test_scores_are_those_of_the_run() -> None:
    controller = SlidingMode(NOMINAL)
    found = benchmark({"one": controller}, {"here": SHORT}).scores["one"]["here"]
    run = SHORT.run(controller)
    distance = np.linalg.norm(run.error[:, :2], axis=-1)
    assert found.largest == distance[100:].max()
    assert found.largest_from_start == distance.max()
    assert found.rms == pytest.approx(np.sqrt(np.mean(distance[100:] ** 2)), rel=1e-12)
    assert found.recovery == 0.0
    off = benchmark({"PD": PD(120, 120)}, {"off": replace(SHORT, offset=(0.3, 0, 0), band=0.2)})
    assert 0 < off.scores["PD"]["off"].recovery < 2
    assert off.values("largest_from_start")[0, 0] == pytest.approx(0.3, rel=0.02)
    assert "largest distance [mm]" in str(off)


BAD: Any = [
    (lambda: benchmark({}), "controllers is {}, expected a mapping of names"),
    (lambda: benchmark({"PD": PD(1, 1)}, {"a": 3}), r"scenarios\['a'\] is 3, expected a BenchmarkScenario"),  # type: ignore[dict-item]
    (lambda: BenchmarkScenario(delay=-1), "delay is -1"),
    (lambda: BenchmarkScenario(noise=-1.0), "noise is -1"),
]


@pytest.mark.parametrize(("make", "words"), BAD)
def test_bad_arguments_are_refused(make: Any, words: str) -> None:
    with pytest.raises(InvalidArgument, match=words):
        make()
