# %% [markdown]
# # 5 Viewing: live, recorded, headless
#
# A table of numbers gives the size of an error. A moving picture shows whether the robot moves as
# intended. This notebook shows the lecture's circle in three ways:
#
# - **recorded**: a web page that any browser plays, without Python and without a network;
# - **headless**: pictures from a computer without a screen;
# - **live**: a web page that shows the poses while the program runs.

# %%
import re
import socket
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlsplit

import numpy as np
from IPython.display import Image, display

from pinmobile import PD, Circle, ComputedTorque, MobileRobot, Tangent, plots, simulate
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE
from pinmobile.errors import ViewerError
from pinmobile.viewer import Arrows, FixedCamera, Follow, Overlays, Viewer

# %% [markdown]
# ## The runs
#
# The lecture's robot follows its circle for 60 s, once under PD and once under computed torque.

# %%
robot = MobileRobot.lecture()
circle = Tangent(Circle(radius=3, rate=0.1, duration=60))
pd = PD((120, 120, 0.4), (120, 120, 0.4))
runs = {
    "PD": simulate(robot, pd, circle, dt=0.1),
    "computed torque": simulate(robot, ComputedTorque(robot), circle, dt=0.1),
}
plots.path(runs, title="The circle: desired and simulated path")

# %% [markdown]
# ## Recorded
#
# A `Viewer` draws a robot. Its method `record` makes a recording of one rollout, or of several rollouts
# with names. The recording shows the robot of the first rollout as a solid and the others as transparent
# ghosts. Here the recording plays four times as fast as the rollout. It has 40 frames per second, so
# each frame shows one sample.

# %%
with Viewer(robot) as viewer:
    recording = viewer.record(runs, fps=40, speed=4, title="The lecture's circle")
print(recording)

# %% [markdown]
# The method `save_html` writes the page. The page is one file, which you can keep, send by mail, and open
# from the file system. This notebook saves it to a temporary folder, which the program deletes. Use a
# file name that you choose.

# %%
with TemporaryDirectory() as folder:
    file = recording.save_html(Path(folder) / "circle.html")
    page = file.read_text(encoding="utf-8")
    print(f"{file.name}: {len(page) / 1e6:.1f} MB")

# %% [markdown]
# The largest part of the file is the program that draws the scene. The page loads nothing from the
# network. To check this, the cell below lists the addresses in all attributes `src` and `href`, which a
# browser loads, and all web addresses in the text of the page:

# %%
tags = r"<(?:script|link|img|iframe)\b[^>]*"
loaded = re.findall(tags + r'\b(?:src|href)="([^"]*)"', page)
addresses = set(re.findall(r"(?:https?|wss?)://[^\s\"'`<>)]+", page))
print("addresses in src and href:", loaded)
print("web addresses:", sorted(addresses))
print("the page connects to a server:", "viewer.connect()" in page)

# %% [markdown]
# The address `data:,` is an empty icon inside the page. The first web address is no request: XML uses it
# as the name of the HTML namespace. The second web address belongs to live viewing: the function
# `connect` uses it, and this page never calls that function.
#
# A notebook can show the page in a frame. But a stored notebook should be small. So the class below
# offers the page and a picture. The running notebook displays the page, and the stored notebook contains
# the picture. A headless browser takes the picture. Without such a browser, the notebook prints a
# message and continues.


# %%
size = (640, 420)  # [pixels]


def still(recording, t):
    """Return a picture of a recording at time t [s], or None without Chromium."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "still.png"
        try:
            return recording.screenshot(file, t=t, size=size).read_bytes()
        except ViewerError as error:
            print("No picture:", error)
            return None


class Scene:
    """Display of a recording in a notebook: the page that plays, or a picture."""

    def __init__(self, recording, t):
        self.page, self.picture = recording.html(), still(recording, t)

    def _repr_html_(self):
        look = "width: 100%; max-width: 900px; height: 560px; border: 0"
        page = escape(self.page)
        return f'<iframe class="scene" style="{look}" srcdoc="{page}"></iframe>'

    def _repr_png_(self):
        return self.picture


# %% tags=["scene"]
display(Scene(recording, t=20))

# %% [markdown]
# The dashed line is the desired path. The bands are the paths of the robots up to the current time. The
# wedge marks the front of the robot. In the running notebook, the slider below the scene selects the
# time, and the mouse rotates the view. The stored notebook shows a still picture: run the notebook to
# see the motion.
#
# The ghost is hardly visible, because an error of 7.5 mm is small compared with a robot of 0.6 m. The
# caption names both robots.
#
# Two more methods save a recording: `save_gif` writes a GIF, and `save_mp4` writes a film for slides
# (after `pip install 'pinmobile[mp4]'`).

# %% [markdown]
# ## Headless
#
# The method `screenshot` needs no screen. It starts a Chromium without a window, opens the recorded
# page, selects the time, takes the picture and closes the browser. It finds an installed Chromium or
# Chrome. The environment variable `PINMOBILE_CHROMIUM` selects another one.
#
# ### Frames
#
# The derivation of [notebook 1](01_from_table_to_equations.ipynb) begins with the frames of a DH table.
# It uses two tables: the one on the slide and the one in the lecture's script. The picture shows the
# frames of both, with the robot at $q = (1.2\ \mathrm{m}, 0.9\ \mathrm{m}, 0.6\ \mathrm{rad})$. It shows
# equal frames of the two tables once. The x, y and z axes are red, green and blue. The frames {2} have
# the same origin as the robot.

# %%
view = FixedCamera(eye=(0.5, -3.2, 2.6), target=(0.7, 0.6, 0.2))
both = Overlays(frames=(LECTURE_TABLE, SLIDE_TABLE), camera=view)
with Viewer(robot, overlays=both) as viewer, TemporaryDirectory() as folder:
    viewer.display((1.2, 0.9, 0.6))
    try:
        file = viewer.screenshot(Path(folder) / "frames.png", size=size)
        display(Image(file.read_bytes()))
    except ViewerError as error:
        print("No picture:", error)

# %% [markdown]
# ### Forces, and a camera that follows
#
# To make the error visible, this run uses PD gains that are twenty times smaller. The robot then moves
# outside the desired pose (the ghost) by about
#
# $$e \approx \frac{r\omega^2}{K_p/m}
# = \frac{0.03\ \mathrm{m/s^2}}{6/30\ \mathrm{1/s^2}} = 0.15\ \mathrm{m} .$$
#
# The arrow is the force of the controller. It points inwards, to the ghost, and keeps the robot on a
# circle. The legend gives its scale. The camera follows the robot at a distance of 3 m.

# %%
weak = simulate(robot, PD((6, 6, 0.4), (6, 6, 0.4)), circle, dt=0.1)
following = Overlays(desired=True, arrows=Arrows(), camera=Follow(distance=3))
with Viewer(robot) as viewer:
    close = viewer.record(weak, fps=10, overlays=following)
picture = still(close, t=40)
if picture:
    display(Image(picture))

# %% [markdown]
# ## Live
#
# With `live=True`, this program serves a page. Open `viewer.url` in a browser. The method `display`
# shows one pose on the page, and `play` shows a whole rollout in real time. The program serves the page
# until the `with` block ends. A browser is optional: `display` does not wait for one.

# %%
with Viewer(robot, live=True) as viewer:
    address = urlsplit(viewer.url)
    print(f"the page is at {address.scheme}://{address.hostname}, on a free port")
    for q in runs["PD"].q[::150]:
        viewer.display(q)
        print("pose: x {:6.3f} m, y {:6.3f} m, psi {:6.3f} rad".format(*q))
    with socket.create_connection((address.hostname, address.port), timeout=5):
        print("the server accepts a connection")

try:
    socket.create_connection((address.hostname, address.port), timeout=5).close()
    server_stopped = False
except ConnectionRefusedError:
    server_stopped = True
    print("the server has stopped")

# %% [markdown]
# The address 127.0.0.1 is the local computer. Other computers on the network cannot open the page.
#
# ### On a server
#
# The program can run on another computer without a screen. An SSH tunnel then transmits the page. In the
# program on the server, select a port:
#
# ```python
# with Viewer(robot, live=True, port=7100) as viewer:
#     viewer.wait(timeout=300)  # until a browser connects
#     viewer.play(runs, repeat=3)
# ```
#
# On your computer, type this command in a terminal, with your user name and the name of the server:
#
# ```
# ssh -N -L 7100:127.0.0.1:7100 you@server
# ```
#
# Then open http://127.0.0.1:7100/ in the browser. Ctrl-C ends the tunnel.

# %% [markdown]
# ## The claim
#
# The recording shows the computed motion: at every sample, both robots have the poses of their rollouts.
# The page loads nothing from the network. A closed viewer accepts no connection.

# %%
tracks = {
    (moving["path"], track["name"]): track
    for moving in recording.tracks
    for track in moving["clip"]["tracks"]
}
for number, (name, run) in enumerate(runs.items()):
    position = tracks[f"meshcat/robot{number}", ".position"]
    rotation = tracks[f"meshcat/robot{number}", ".quaternion"]
    x, y, z = np.reshape(position["values"], (-1, 3)).T
    quaternion = np.reshape(rotation["values"], (-1, 4))
    psi = 2 * np.arctan2(quaternion[:, 2], quaternion[:, 3])  # [rad], up to full turns
    turn = np.abs(np.exp(1j * psi) - np.exp(1j * run.q[:, 2])).max()
    assert np.allclose(position["times"], run.t, atol=1e-4), f"{name}: the times differ"
    assert np.abs(x - run.q[:, 0]).max() < 1e-5, f"{name}: x differs"
    assert np.abs(y - run.q[:, 1]).max() < 1e-5, f"{name}: y differs"
    assert turn < 1e-5, f"{name}: the heading differs"
harmless = {"http://www.w3.org/1999/xhtml", "ws://${location.host}"}
error_weak = np.hypot(*weak.error[400:, :2].T).max()  # [m], from 40 s on
assert loaded == ["data:,"], "the page loads a file"
assert addresses == harmless, "the page contains another address"
assert "viewer.connect()" not in page, "the page connects to a server"
assert server_stopped, "the closed viewer accepts a connection"
assert 0.12 < error_weak < 0.18, "the error of the weak PD differs from the estimate"
print("Shown: the recording equals the rollouts, and the page needs no network.")
print("Shown: a closed viewer accepts no connection.")
