"""What was compared, and with what result: a table."""

from dataclasses import dataclass

from pinmobile.robot import MobileRobot

__all__ = ["Comparison", "Verification"]


@dataclass(frozen=True)
class Comparison:
    """The largest difference of one quantity between two routes.

    Attributes
    ----------
    quantity : str
        ``"M"``, ``"n"``, ``"tau"`` or ``"a"``; of a robot with arms also ``"M3"``, its base's block, and
        ``"f"``, the ground's wrench.
    route, against : str
        The two routes.
    difference : float
        Largest difference over all states, relative to the scale of the terms.
    bound : float
        Largest difference that rounding explains.
    """

    quantity: str
    route: str
    against: str
    difference: float
    bound: float

    @property
    def agrees(self) -> bool:
        """Whether the difference is within the bound."""
        return self.difference <= self.bound


@dataclass(frozen=True)
class Verification:
    """All comparisons for one robot; printed, it is a table.

    Attributes
    ----------
    robot : MobileRobot
        What was verified.
    states : int
        Number of random states.
    rows : tuple of Comparison
        One per quantity and route.
    missing : str
        Which route there is none of, and why; empty where all are there.
    """

    robot: MobileRobot
    states: int
    rows: tuple[Comparison, ...]
    missing: str = ""

    @property
    def passed(self) -> bool:
        """Whether every comparison agrees."""
        return all(row.agrees for row in self.rows)

    @property
    def largest(self) -> dict[str, float]:
        """Largest difference of each quantity over the routes."""
        quantities = dict.fromkeys(row.quantity for row in self.rows)
        return {q: max(row.difference for row in self.rows if row.quantity == q) for q in quantities}

    def __str__(self) -> str:
        against = {row.against for row in self.rows}
        names = [row.route if len(against) == 1 else f"{row.route} / {row.against}" for row in self.rows]
        width = max(32, *map(len, names))
        head = f"{'':3} {'route':{width}} {'largest difference':>18} {'bound':>9}"
        lines = [
            f"{row.quantity:3} {name:{width}} {row.difference:18.1e} {row.bound:9.1e}  "
            f"{'agrees' if row.agrees else 'DIFFERS'}"
            for name, row in zip(names, self.rows, strict=True)
        ]
        what = f"the {against.pop()}" if len(against) == 1 else "another"
        left_out = [f"left out, {self.missing}"] if self.missing else []
        return "\n".join([f"{self.states} random states, each route against {what}", head, *lines, *left_out])
