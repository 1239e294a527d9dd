"""`play`: a run in real time on a live page, which changes its numbers, drives its robot and pushes it."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from time import monotonic
from typing import Any

import numpy as np

import pinmobile.viewer.scene_tree as shapes
from pinmobile.arrays import Array, rotate, sequence
from pinmobile.controllers import Controller
from pinmobile.errors import PinmobileError
from pinmobile.loop import LoopStepper, Rollout, Scenario
from pinmobile.palette import QUIET, colour
from pinmobile.parts import Driven, NumberRef, Pushable, Tabled, Touching, able, array, entries_of, part
from pinmobile.plant import Contacts, Plant, robot_at, stated
from pinmobile.robot import MobileRobot
from pinmobile.signals import Signal
from pinmobile.trajectories import Reference, Trajectory
from pinmobile.viewer.contact_markers import ABOVE, TRAIL, draw_contacts
from pinmobile.viewer.motion import Channel, figure, pose_channels, row_of
from pinmobile.viewer.scene import Scene, draw_path, time_channels
from pinmobile.viewer.scene_tree import Extent, Follow, Overlays, Stage
from pinmobile.viewer.server import LiveWindow

_FPS = 60
_CONTACT_STEP = 4  # frames between two looks at contacts, which take long
_BLOCK, _BLOCKS = 15, 41  # frames that the page receives as a whole; they last more than 10 s
_SERIES = 6  # series of a plot
_SLOW_PACE = 0.95  # of real time; the page states less
_MAX_PERIOD = 0.5  # [s] of real time that a frame makes up for
_MAX_ADVANCE = 0.1  # [s] of the run that one frame computes at most
_EXTENT = 1e-3  # [m]: smallest size of a visible trail
_GROUND_SIZE = 5.0  # [m] of the floor around the robot
_TRAIL_STEP, _TRAIL_POINTS = 3, 200  # frames between two points of the trail, and points: 10 s
_PULSE, _EVENT_TIME = 0.25, 0.6  # [s] duration of a push, and for which an event is shown
_PUSH_ACCELERATION = 9.81 / 4  # [m/s^2] acceleration by a push
_MASS, _LENGTH = 10.0, 1.0  # [kg, m] of a plant without a mass matrix; of the arm of a moment
_RISE_TIME = 0.4  # [s] until the driven reference has the speed of a key
_FORCE = "forces.hand.force."
_AXES = ("x", "y", "moment")


@part
class _Hand:
    """Force on the body whose numbers the page changes."""

    force: Any = array(default=(0.0,) * 3, unit="N, N, N m", labels=_AXES, doc="force by hand")

    def __call__(self, t: Any, q: Any, v: Any) -> Any:
        """Return the force, shape (..., 3) [N, N, N m]."""
        return self.force + 0.0 * q


class _Drive:
    """Reference of a robot that keys drive: a twist of the body, integrated from the robot's pose.

    Parameters
    ----------
    plant : plant
        Plant to drive.
    reference : Reference
        Reference of the trajectory, whose largest speeds are those of the keys.
    """

    def __init__(self, plant: Any, reference: Reference) -> None:
        rates = reference.v
        speed = float(np.hypot(rates[:, 0], rates[:, 1]).max()) or 0.5
        turn = float(np.abs(rates[:, 2]).max()) or 1.0
        mobility = stated(plant, "mobility")
        kind = (2, 0) if mobility is None else (mobility.mobility, mobility.steerability)
        self.curves = kind == (1, 1) or stated(plant, "wheelbase") is not None  # it turns only while it moves
        self.scale = np.array([speed, speed if sum(kind) > 2 and kind != (2, 1) else 0.0, turn])
        self.twist, self.q = np.zeros(3), np.zeros(0)

    def begin(self, pose: Array, rate: Array, reference: Reference) -> None:
        """Begin at the pose of the body, shape (3,), with its rate; arms keep their reference."""
        self.q = reference.q[0].copy()
        self.q[:3] = pose
        self.twist = rotate(np.cos(pose[2]), -np.sin(pose[2]), rate) * (self.scale > 0)

    def ahead(self, keys: Array, count: int, dt: float) -> Reference:
        """Return the reference of the next samples for keys (ahead, turn, aside) from -1 to 1."""
        goal = self.scale * keys[[0, 2, 1]]
        if self.curves:
            goal[2] *= keys[0]
        rows = []
        for _ in range(count):
            change = np.clip(goal - self.twist, *(self.scale * dt / _RISE_TIME * np.array([[-1.0], [1.0]])))
            v, a = np.zeros((2, len(self.q)))
            turn = np.cos(self.q[2]), np.sin(self.q[2])
            v[:3] = rotate(*turn, self.twist)
            a[:3] = rotate(*turn, change / dt) + self.twist[2] * np.array([-v[1], v[0], 0.0])
            rows.append((self.q, v, a))
            self.q, self.twist = self.q + dt * v + dt**2 / 2 * a, self.twist + change
        return Reference(*map(np.array, zip(*rows, strict=True)))


class LiveRun:
    """A run in real time on a live page; `play` makes it.

    A thread advances the compiled loop 60 times per second until the run is closed. The page has a slider for
    each selected number, buttons (pause, reset, push), and plots of error, inputs and wheel loads over the
    last ten seconds. Keys W, S, A, D, Q, E, arrows or a gamepad drive a robot on wheels: from the first key
    on, the reference is a twist that the keys command, integrated from the robot's pose, until a reset. The
    keys push the body of another plant along its own axes. The first page that presses a key or control
    drives until it is closed; all others watch. After its end, the reference of the trajectory rests.

    Parameters
    ----------
    scenario : Scenario
        Loop of the run; its spread and n have no effect.
    sliders : sequence of str
        Paths of the numbers, such as ``"controller.kp"``, or their ends.
    host : str
        Address to serve at, see `LiveWindow`.
    port : int, optional
        Port to serve at; default: a free port.

    Attributes
    ----------
    url : str
        Address of the page.

    Raises
    ------
    InvalidArgument, UnknownName
        If an argument is invalid, or the loop cannot be compiled.
    ViewerError
        If the run cannot serve at this address.

    See Also
    --------
    viewer.play : run of a loop from its parts
    Rollout : recorded samples of a run

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Scenario
    >>> from pinmobile import Tangent
    >>> from pinmobile.viewer import LiveRun
    >>> loop = Scenario(robot=MobileRobot(30.0, 1.3),
    ...                 controller=PD(120, 120),
    ...                 trajectory=Tangent(Circle(1.0, 0.5, 9.0)),
    ...                 n=1, spread={}, dt=0.01)
    >>> with LiveRun(loop, ["controller.kp"]) as run:
    ...     run.url
    'http://127.0.0.1:.../'
    """

    def __init__(
        self,
        scenario: Scenario,
        sliders: Sequence[str] = (),
        *,
        host: str = "127.0.0.1",
        port: int | None = None,
    ) -> None:
        self._plant = plant = robot_at(scenario.robot, 0.0)
        self._drawn = drawn = robot_at(scenario.robot, np.zeros(1))  # also with what it holds at other times
        self._has_hand, forces = able(plant, Pushable) is not None, scenario.forces
        if self._has_hand:
            forces = {**dict(entries_of(forces)), "hand": _Hand()}
        nominal = replace(scenario, n=1, spread={}, forces=forces)
        names = sequence("sliders", sliders, 'names of numbers, such as ["controller.kp"]')
        numbers = {one.path: (name, one) for name in names for one in [scenario.find(name, "sliders")]}
        spread = {path: float(one.value) for path, (_, one) in numbers.items()}
        self._sliders, self._values = numbers, dict(spread)
        spread |= {f"{_FORCE}{axis}": 0.0 for axis in (_AXES if self._has_hand else ())}
        self._stepper = LoopStepper(replace(nominal, spread=spread))
        self._can_drive = self._stepper.follows and any(able(plant, x) for x in (Tabled, Driven))
        self._drive = _Drive(plant, nominal.reference)
        mass_matrix = stated(plant, "mass_matrix")
        M = np.eye(3) * _MASS if mass_matrix is None else np.asarray(mass_matrix(nominal.start[0]))
        self._mass, self._arm = float(M[0, 0]), float(M[2, 2] / M[0, 0]) / _LENGTH
        self._push = _PUSH_ACCELERATION * self._mass
        self._contact_channels: list[Channel] = []
        self._messages: deque[tuple[object, str]] = deque()
        self._driver: object = None
        self._lock, self._end, self._pace = threading.RLock(), threading.Event(), 1.0
        self._window = LiveWindow(host, port)
        self._stage, self._figure = Stage(self._window), figure(drawn)
        with ExitStack() as failure:
            failure.callback(self._window.close)
            self._begin()
            self._draw_scene()
            failure.pop_all()
        self._window.listen(lambda browser, text: self._messages.append((browser, text)))
        self._thread = threading.Thread(target=self._run, name="pinmobile-play", daemon=True)
        self._thread.start()

    def __enter__(self) -> LiveRun:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def url(self) -> str:
        """Address of the page, with the token if requests need one."""
        return self._window.url

    def rollout(self) -> Rollout:
        """Return the run since the last reset; its signals contain the numbers of sliders and pushes.

        Of a very long run, it contains the last samples only, some 100 MB.

        Returns
        -------
        Rollout
            Samples until now.
        """
        with self._lock:
            return self._stepper.rollout()

    def close(self) -> None:
        """End the run and stop serving. `rollout` remains usable."""
        self._end.set()
        self._thread.join()
        self._window.close()

    # The run

    def _begin(self) -> None:
        """Start at the first sample, and clear the display of the previous run."""
        self._keys, self._pulse, self._time, self._frames = np.zeros(3), 0.0, 0.0, 0
        self._is_driven = self._paused = False
        self._rows: list[float] = []
        self._points: deque[Array] = deque(maxlen=_TRAIL_POINTS)
        self._events: dict[str, tuple[str, float]] = {}
        self._stepper.reset(self._values | self._force(np.zeros(3)))
        self._desired, self._pushes = self._stepper.reference.q[0], np.zeros(3)
        self._last = {name: x[-1] for name, x in self._stepper.advance(1).items()}
        self._previous = self._last

    def _run(self) -> None:
        begin, frame = monotonic(), 0
        while not self._end.wait(max(begin + frame / _FPS - monotonic(), 0.0)):
            frames = 1 + max(int((monotonic() - begin) * _FPS - frame), 0)  # those that are late are left out
            frame += frames
            with self._lock:
                try:
                    self._read_messages()
                    if not self._paused:
                        self._frame(min(frames / _FPS, _MAX_PERIOD))
                except PinmobileError as error:  # of a part, such as a trajectory that becomes impossible
                    self._pause(True, str(error))

    def _frame(self, period: float) -> None:
        """Advance the run by a period [s], or less if the loop is slow, and show it."""
        previous, self._time = self._time, self._time + period
        self._advance()
        self._pace += (self._time - previous) - period * self._pace  # mean of a second
        self._show()

    def _read_messages(self) -> None:
        """Execute the messages of the driver's page."""
        while self._messages:
            browser, text = self._messages.popleft()
            name, word, *numbers = [*text.split(), "", ""][: max(2, len(text.split()))]
            if not text:
                if browser is self._driver:
                    self._driver, self._keys = None, np.zeros(3)
                    self._stage.publish("driver", "")
                continue
            if self._driver is None:
                self._driver = browser
                self._stage.publish("driver", name)
            if browser is self._driver:
                with suppress(ValueError, IndexError):  # another program's words
                    self._execute(word, list(map(float, numbers)))

    def _execute(self, word: str, numbers: list[float]) -> None:
        if word == "keys" and len(numbers) == len(_AXES):
            self._keys = np.clip(np.nan_to_num(numbers), -1.0, 1.0)
            if self._can_drive and not self._is_driven and self._keys.any():
                q, v = self._last["q"], self._last["v"]
                pose, rate = np.asarray(self._plant.pose(q)), np.asarray(self._plant.pose_rate(q, v))
                self._drive.begin(pose, rate, self._stepper.ahead(1))
                self._is_driven = True
        elif word == "push":
            self._pulse = self._time + _PULSE
        elif word == "pause":
            self._pause(not self._paused)
        elif word == "reset":
            self._begin()
            self._clear()
        elif word == "slider":
            low, high = self._ranges[int(numbers[0])]
            self._set([*self._sliders, ""][int(numbers[0])], min(max(numbers[1], low), high))

    def _set(self, name: str, value: float) -> None:
        """Change the number of a slider, or the push for ""; an impossible value has no effect."""
        if not name:
            self._push = value
        else:
            message, values = "", self._values
            self._values = values | {name: value}
            try:
                self._stepper.change(self._stepper.values | self._values)
            except PinmobileError as error:
                self._values, message = values, str(error)
            self._stage.publish("message", message)
            self._draw_path()
        self._stage.publish("values", [*self._values.values(), self._push])

    def _pause(self, paused: bool, message: str = "") -> None:
        self._paused = paused
        self._stage.publish("paused", paused)
        self._stage.publish("message", message)

    def _force(self, force: Array) -> dict[str, float]:
        names = (f"{_FORCE}{axis}" for axis in _AXES)
        return dict(zip(names, map(float, force), strict=True)) if self._has_hand else {}

    def _advance(self) -> None:
        """Compute the samples until the present, with the present keys."""
        stepper, dt = self._stepper, self._stepper.scenario.dt
        count = int(np.ceil(self._time / dt - 1e-6)) + 1 - stepper.k
        limit = int(np.ceil(_MAX_ADVANCE / dt))
        if count > limit:  # slower than real time
            count = limit
            self._time = (stepper.k + count - 1) * dt
        if count < 1:
            return
        push = np.zeros(3) if self._can_drive else self._push * self._keys * (1, 1, self._arm)
        if self._time < self._pulse:
            push[1] += self._push
        heading = float(self._plant.pose(self._last["q"])[2])
        self._pushes = rotate(np.cos(heading), np.sin(heading), push)
        force = self._force(self._pushes)
        if any(stepper.values[name] != x for name, x in force.items()):
            stepper.change(stepper.values | force)
        reference = self._drive.ahead(self._keys, count, dt) if self._is_driven else stepper.ahead(count)
        samples = stepper.advance(count, reference)
        columns = np.hstack([samples[name] for name in ("q", "v", "a", "u", "error")])
        if not (np.abs(samples["error"]) <= stepper.scenario.limit).all() or not np.isfinite(columns).all():
            self._pause(True, "the loop has diverged: reset begins again")
            return
        rows = [self._last, *({name: x[k] for name, x in samples.items()} for k in range(count))]
        self._previous, self._last = rows[-2:]
        self._desired = reference.q[-1]
        self._record_events(samples)

    def _record_events(self, samples: Mapping[str, Array]) -> None:
        """Remember the events of the newest samples: margins below zero, sliding wheels, tipping over."""
        events, slides = {}, samples.get("signal slides")
        if np.any(samples.get("signal tips", 0.0)):
            events["tip over"] = "tip over"
        columns = samples.get("measured", np.zeros((0, 0))).T
        for one, column in zip(self._stepper.scenario.recorded_metrics, columns, strict=False):
            if one.is_margin and column.min() < 0:
                size = f" {column.min():.2g} {one.unit}" if np.isfinite(column.min()) else ""
                events[one.name] = f"{one.name}{size}"
            elif one.worst == "ever" and column.max() > 0:
                events[one.name] = one.name
        if self._frames % _CONTACT_STEP == 0:
            self._newest_contacts = self._contacts()
        if self._newest_contacts is not None and slides is not None:
            pairs = zip(self._newest_contacts.names, slides.max(axis=0).tolist(), strict=True)
            events |= {name: f"{name} slides" for name, one in pairs if one}
        self._has_event = bool(events)
        self._events |= {name: (text, self._time + _EVENT_TIME) for name, text in events.items()}

    @property
    def _newest_time(self) -> float:
        """Time of the newest sample [s]."""
        return self._stepper.scenario.dt * (self._stepper.k - 1)

    def _contacts(self) -> Contacts | None:
        """Return the contacts at the newest sample; None if the plant has none, or cannot compute them."""
        plant = able(robot_at(self._stepper.scenario.robot, self._newest_time), Touching)
        units = self._stepper.units
        if plant is None:
            return None
        states = (self._last[name][None] for name in "qvau")
        signals = {name: Signal(unit, self._last[f"signal {name}"][None]) for name, unit in units.items()}
        with suppress(PinmobileError):  # a gear train, for instance, has no force of each wheel
            contacts: Contacts = plant.contacts(*states, signals)
            return contacts
        return None

    # The page

    def _draw_scene(self) -> None:
        """Draw the static objects, and publish the contents of the page."""
        self._stage.remove("meshcat")
        q, scenario = self._last["q"], self._stepper.scenario
        overlays = Overlays(camera=Follow(distance=4.5 * max(self._figure.size[:2])))
        self._scene = scene = Scene(self._stage, self._figure, overlays)
        pose = row_of(self._figure, self._drawn, q)
        scene.draw_robot(pose, _GROUND_SIZE)
        self._extent = Extent(pose[:2] - _GROUND_SIZE, pose[:2] + _GROUND_SIZE, self._figure.size)
        self._stage.set("meshcat/scale", "visible", False)  # the grid goes along with the robot
        self._stage.robot("meshcat/desired", MobileRobot.box(size=self._figure.size), QUIET, ghost=True)
        self._stage.put("meshcat/push", shapes.overlay(shapes.arrow(0.09), colour(3), order=ABOVE))
        self._draw_path()
        self._record_events({})
        contacts = self._newest_contacts
        legend = [["travelled", colour(0), "", 0.0], ["desired pose", QUIET, "", 0.5]]
        if contacts is not None:
            legend += self._draw_contacts(contacts)[1]
        self._stage.publish("legend", [*legend, [f"grid {self._extent.step:g} m", "#c9cdd1", "", 0.0]])
        lists: dict[str, Any] = {"error": scenario.coordinates[:_SERIES], "input": scenario.inputs[:_SERIES]}
        series = {title: [(one.name, one.unit) for one in each] for title, each in lists.items()}
        self._has_loads = contacts is not None and bool(np.isfinite(contacts.loads).all())
        if contacts is not None and self._has_loads:
            series["wheel load"] = [(name, "N") for name in contacts.names[:_SERIES]]
        plots = []
        for title, each in series.items():
            units = list(dict.fromkeys(unit for _, unit in each if unit))
            names = [f"{name} [{unit}]" if len(units) > 1 else name for name, unit in each]
            lines = [[name, colour(i)] for i, name in enumerate(names)]
            plots.append({"title": f"{title} [{', '.join(units)}]", "series": lines})
        sliders = [self._slider_row(name, one) for name, one in self._sliders.values()]
        if self._has_hand:
            sliders.append(["push", "N", "force of a push", 0.0, 9.81 * self._mass])
        self._ranges = [(low, high) for *_, low, high in sliders]
        panel = {"sliders": sliders, "plots": plots, "keys": self._help(), "push": self._has_hand}
        width = 2 + sum(len(each["series"]) for each in plots)
        self._stage.publish("panel", panel | {"blocks": _BLOCKS, "size": width})
        self._stage.publish("driver", "")
        self._clear()

    def _slider_row(self, name: str, number: NumberRef) -> list[Any]:
        """Return name, unit, meaning and range of a number: its bounds, else up to three times its value."""
        one: Any = number.leaf.declared
        low, high = sorted((0.0, 3 * float(number.value))) if number.value else (-1.0, 1.0)
        high = high if one.upper is None else float(one.upper)
        if one.above is not None:
            low = one.above + 1e-3 * (high - one.above)
        return [name, number.unit, number.meaning, low if one.lower is None else float(one.lower), high]

    def _help(self) -> list[list[str]]:
        """Return the keys and their meanings."""
        speed, lateral, turn = self._drive.scale
        drive_keys = {"W S": f"drive at {speed:.2g} m/s", "A D": f"turn at {turn:.2g} rad/s"}
        drive_keys |= {"Q E": f"move aside at {lateral:.2g} m/s"} if lateral else {}
        push_keys = {"W S": "push ahead, back", "A D": "push left, right", "Q E": "turn"}
        keys = drive_keys if self._can_drive else push_keys if self._has_hand else {}
        keys = keys | ({"space": "push to the left"} if self._has_hand else {})
        return [list(each) for each in (keys | {"P": "pause", "R": "reset"}).items()]

    def _draw_path(self) -> None:
        """Draw the path of the trajectory."""
        draw_path(self._stage, self._stepper.reference.q[:, :2], self._extent)

    def _clear(self) -> None:
        """Empty plots and trail, and state the numbers."""
        self._stage.remove("meshcat/trail")
        for k in range(_BLOCKS):
            self._stage.publish(f"rows{k}", "[]")
        self._stage.publish("events", [])
        self._stage.publish("values", [*self._values.values(), self._push])
        self._pause(False)
        self._show()

    def _draw_contacts(self, contacts: Contacts) -> tuple[list[Channel], list[list[object]]]:
        """Return channels and legend of the contacts; their shapes are sent once."""
        stage = self._stage if self._frames == 0 else _SilentStage(self._stage.window)
        scale = 1.5 * self._extent.unit / (9.81 * self._mass)
        x, y, psi = np.asarray(self._plant.pose(self._last["q"]))
        offsets = contacts.places - (x, y)
        places = offsets @ np.array([[np.cos(psi), -np.sin(psi)], [np.sin(psi), np.cos(psi)]])
        relative = contacts._replace(places=places, directions=contacts.directions - psi)
        return draw_contacts(stage, relative, self._extent, scale, "meshcat/robot0")

    def _show(self) -> None:
        """Send the present frame: poses, a row of the plots, the trail and the events."""
        plant, last, dt = self._plant, self._last, self._stepper.scenario.dt
        share = np.clip(1 + self._time / dt - (self._stepper.k - 1), 0.0, 1.0)
        previous = self._previous["q"]
        q = np.asarray(plant.integrate(previous, share * np.asarray(plant.difference(previous, last["q"]))))
        row = row_of(self._figure, self._drawn, q)
        channels = [one for attachment in self._scene.attachments for one in attachment(row[None])]
        channels += time_channels("meshcat/robot0", self._drawn, np.array([self._newest_time]))
        channels += pose_channels("meshcat/desired", self._desired[None, :3])
        if self._frames % _CONTACT_STEP == 0 and self._newest_contacts is not None:
            self._contact_channels = self._draw_contacts(self._newest_contacts)[0]
        channels += self._contact_channels + self._push_channels(row)
        cell = self._extent.step
        floor = np.append(cell * np.round((row[:2] - self._extent.centre) / cell), 0.0)
        channels.append(Channel("meshcat/grid", "position", floor[None]))
        moves = [[one.path, one.name, one.at(0)] for one in channels]
        self._stage.publish("moves", json.dumps(moves))  # packed much faster than its numbers
        self._draw_trail(row[:2])
        self._send_plots()
        if self._frames % _CONTACT_STEP == 0:
            texts = [text for text, end in self._events.values() if end > self._time]
            self._stage.publish("events", texts)
            pace = f", {self._pace:.1f} times real time" if self._pace < _SLOW_PACE else ""
            mode = ", driven" if self._is_driven else ""
            self._stage.publish("caption", f"t = {self._time:.1f} s{mode}{pace}")
        self._frames += 1

    def _push_channels(self, row: Array) -> list[Channel]:
        """Return the channels of the arrow of a push, which ends at the body."""
        size = float(np.hypot(*self._pushes[:2]))
        angle = float(np.arctan2(self._pushes[1], self._pushes[0]))
        length = max(1.2 * self._extent.unit * min(size / (_PUSH_ACCELERATION * self._mass), 2.0), 1e-4)
        placement = np.array([row[0] - length * np.cos(angle), row[1] - length * np.sin(angle), angle])
        scale = Channel("meshcat/push", "scale", np.full((1, 3), length))
        return [*pose_channels("meshcat/push", placement[None], self._figure.size[2]), scale]

    def _draw_trail(self, point: Array) -> None:
        if self._frames % _TRAIL_STEP == 0:
            self._points.append(point)
        if self._frames % (_CONTACT_STEP * _TRAIL_STEP) == 0 and np.ptp(self._points, axis=0).max() > _EXTENT:
            band = shapes.ribbon(np.array(self._points), 0.05 * self._extent.unit)
            self._stage.put("meshcat/trail", shapes.flat(band, colour(0), order=TRAIL))

    def _send_plots(self) -> None:
        """Send the row of this frame with those of its block."""
        if self._frames % _BLOCK == 0:
            self._rows = []
        row = [self._last["error"][:_SERIES], self._last["u"][:_SERIES]]
        if self._has_loads and self._newest_contacts is not None:
            row.append(np.nan_to_num(self._newest_contacts.loads[0, :_SERIES]))
        self._rows += [self._time, *np.concatenate(row).tolist(), float(self._has_event)]
        self._stage.publish(f"rows{self._frames // _BLOCK % _BLOCKS}", json.dumps(self._rows))


class _SilentStage(Stage):
    """Stage that sends no shapes."""

    def put(self, path: str, shape: Any) -> None:
        """Do nothing."""


def play(
    plant: Plant,
    controller: Controller,
    trajectory: Trajectory,
    *,
    sliders: Sequence[str] = (),
    host: str = "127.0.0.1",
    port: int | None = None,
    **options: Any,
) -> LiveRun:
    """Run a closed loop in real time on a live page.

    Parameters
    ----------
    plant, controller, trajectory
        Parts of the loop, see `simulate`. The loop must be one that can be compiled.
    sliders : sequence of str
        Paths of numbers that the page changes, such as ``"controller.kp"`` or ``"mass"``, as in a spread of
        `ensemble`. Their bounds, units and meanings are those of their declarations.
    host : str
        Address to serve at, see `LiveWindow`.
    port : int, optional
        Port to serve at; default: a free port.
    **options
        ``dt`` and the other arguments of `simulate`: ``duration``, ``integrator``, ``substeps``, ``forces``,
        ``limit`` and ``seed``. The run goes on after `duration`; the reference then rests.

    Returns
    -------
    LiveRun
        The run, with the address of its page. It lasts until it is closed.

    Raises
    ------
    InvalidArgument, UnknownName
        If an argument is invalid, or the loop cannot be compiled.
    ViewerError
        If the run cannot serve at this address.

    See Also
    --------
    simulate : the same loop without a page
    viewer.LiveRun : the run and its page
    viewer.Viewer : playback of recorded runs

    Examples
    --------
    >>> from pinmobile import Circle, ComputedTorque, MobileRobot
    >>> from pinmobile import Tangent
    >>> from pinmobile.viewer import play
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> circle = Tangent(Circle(1.0, 0.5, 9.0))
    >>> parts = robot, ComputedTorque(robot), circle
    >>> with play(*parts, dt=0.01, sliders=["controller.kp"]) as run:
    ...     page = run.url  # open it in a browser
    >>> run.rollout().signals["controller.kp"].unit
    '1/s^2'
    """
    parts: dict[str, Any] = {"robot": plant, "controller": controller, "trajectory": trajectory}
    return LiveRun(Scenario(n=1, spread={}, **parts, **options), sliders, host=host, port=port)
