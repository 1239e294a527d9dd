"""What can be done with a body that carries: mount arms, attach loads, lump all of it."""

from abc import abstractmethod
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np
import pinocchio as pin

from pinmobile import urdf
from pinmobile.arrays import ArrayLike, finite
from pinmobile.errors import InvalidArgument, shown
from pinmobile.robot.arms import Arm
from pinmobile.robot.engine import BODY_JOINT
from pinmobile.robot.mounts import Load, Mount, checked_name, free_name, mount_after, on_top, placed
from pinmobile.robot.sources import read_arm
from pinmobile.robot.stance import Stance
from pinmobile.robot.wrenches import ChainWrenches

__all__ = ["Carrier"]


class Carrier(ChainWrenches):
    """Abstract base: a body of some size that can carry arms and loads."""

    stance: Stance
    source: str

    @abstractmethod
    def _carrying(self, mounts: tuple[Mount, ...], loads: tuple[tuple[str, Load], ...]) -> Self:
        """Return the same body that carries these instead."""

    @abstractmethod
    def with_body(self, body: urdf.Body, source: str) -> Self:
        """Return another body, bare, that looks and stands the same."""

    def mount(
        self,
        arm: Any,
        at: ArrayLike | None = None,
        *,
        name: str | None = None,
        package_dirs: str | PathLike[str] | Sequence[str | PathLike[str]] = (),
        visual: pin.GeometryModel | None = None,
        rest: ArrayLike | None = None,
        locked: Sequence[str] = (),
    ) -> Self:
        """Return the robot with an arm on its body; q and v then end with the arm's joints.

        A root of its own (free-flyer, planar) is replaced by the chain, and wheels are locked. Its joints and
        frames are called ``name/...``; its limits, its rotors and its reference posture are kept, and so are
        its joints' damping and friction, by which `JointFriction.of(robot)` acts. Equal position limits, as
        lower = upper = 0, and a velocity or effort limit of 0 are none: that is what files write, some of the
        loaders' too, where they know none. A joint that mimics another in a URDF,
        as the panda's second finger, moves freely, since Pinocchio's forward dynamics knows no mimic joints;
        a `pin.Model` that has them is refused. To keep such a joint still, name it in `locked`.

        Parameters
        ----------
        arm : str, path, pin.Model or pin.RobotWrapper
            One of `mountable()`, such as ``"ur5"``; a URDF; or a model.
        at : array_like, shape (4,), optional
            Where its root stands on the body: x, y, z above the ground and yaw [m, m, m, rad]; by default in
            the middle, at the height `top`, unless that is not known or another arm stands there. What has a
            free-flyer root, or a loader that gives it one, stands on its feet instead, its root as high as
            puts its lowest frame at rest there; so does what would otherwise hang below the ground.
        name : str, optional
            By default that of the arm; numbered where it is taken.
        package_dirs : str, path, or sequence of them
            Folder or folders that ``package://`` in a URDF's mesh names refers to.
        visual : pin.GeometryModel, optional
            What is drawn of a `pin.Model`.
        rest : array_like, shape (arm's nq,), optional
            Its reference posture, within its limits; by default the loader's, or the neutral one, brought
            within them.
        locked : sequence of str
            Its joints that shall not move, at rest.

        Raises
        ------
        InvalidArgument
            If the arm cannot be read, or is larger than `MobileRobot.from_urdf` takes; a joint of it moves no
            inertia, carries what no rigid body is, or has limits that limit nothing; without `at`, the middle
            is taken or the top not known; or another argument is not what is expected.
        UnknownName
            If no loader has the name; the nearest come first.
        """
        asked = None if at is None else placed(at)
        ready = read_arm(arm, package_dirs=package_dirs, visual=visual, rest=rest, locked=locked)
        place = self._free_place(ready) if asked is None else asked
        wanted = checked_name(name if name is not None else Path(ready.origin.value).stem)
        taken = {mount.name for mount in self.mounts}
        mount = mount_after(self._model, ready, free_name(wanted, taken), place)
        return self._carrying((*self.mounts, mount), self.loads)

    def _free_place(self, arm: Arm) -> tuple[float, float, float, float]:
        top = self.stance.top
        if top is None:
            raise InvalidArgument(
                f"at is not given for {arm.origin.value!r}, and the top of the robot is not known, "
                "expected x, y, z and yaw; robot.source says what its file lacks"
            )
        place = on_top(top, arm)
        for mount in self.mounts:
            if mount.at[:2] == place[:2]:
                raise InvalidArgument(
                    f"at is not given for {arm.origin.value!r}, and {mount.name!r} stands in the middle "
                    "already, expected x, y, z and yaw"
                )
        return place

    def attach(self, load: Load, frame: str | None = None) -> Self:
        """Return the robot with a load fixed to one of its frames.

        Parameters
        ----------
        load : Load
            Mass, centre of mass, inertia, size.
        frame : str, optional
            One of `frame_names`; by default `end_effector`.

        Raises
        ------
        InvalidArgument
            If `load` is something else, or so heavy that the dynamics are lost to rounding beside it; or if
            the frame is of a virtual link of the chain, which moves with the robot in part only.
        UnknownName
            If there is no such frame.
        """
        if not isinstance(load, Load):
            raise InvalidArgument(f"load is {shown(load)}, expected a Load")
        name, number = self._frame(frame)
        if self._model.frames[number].parentJoint < BODY_JOINT:
            raise InvalidArgument(
                f"frame is {name!r}, a virtual link, expected 'base_link' or a frame of an arm"
            )
        return self._carrying(self.mounts, (*self.loads, (name, load)))

    @property
    def base(self) -> Self:
        """The robot without what it carries."""
        return self._carrying((), ()) if self.mounts or self.loads else self

    def lumped(self, q: ArrayLike | None = None) -> Self:
        """Return the bare robot that has the mass and inertia of all, arms locked where they are.

        Parameters
        ----------
        q : array_like, shape (nq,) or (nq - 3,), optional
            Configuration, or the arms' part of it; by default `rest`.

        Raises
        ------
        InvalidArgument
            If it has another shape or is not finite.
        """
        posture = finite("q", self.rest if q is None else q)
        if posture.shape == (self.nq - 3,):
            posture = np.concatenate([np.zeros(3), posture])
        if posture.shape != (self.nq,):
            raise InvalidArgument(f"q has shape {posture.shape}, expected ({self.nq},) or ({self.nq - 3},)")
        total = self._engine.composite(self._here(posture))
        body = urdf.Body(total.mass, total.lever, total.inertia)
        return self.with_body(body, f"{self.source}; arms locked")
