# %% [markdown]
# # 5 Viewing: live, recorded, headless
#
# A table of numbers says how large an error is; a moving picture says whether the robot does what one
# thinks. This notebook shows the lecture's circle in three ways:
#
# - **recorded**: a page that plays in any browser, without Python and without a network;
# - **headless**: pictures from a machine that has no screen;
# - **live**: a page that shows what the program does while it does it.

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
# ## What is to be seen
#
# The robot of the lecture on its circle, 60 s long, once with PD and once with computed torque.

# %%
robot = MobileRobot.lecture()
circle = Tangent(Circle(radius=3, rate=0.1, duration=60))
runs = {
    "PD": simulate(robot, PD((120, 120, 0.4), (120, 120, 0.4)), circle, dt=0.1),
    "computed torque": simulate(robot, ComputedTorque(robot), circle, dt=0.1),
}
plots.path(runs, title="The circle: desired and travelled path")

# %% [markdown]
# ## Recorded
#
# A `Viewer` draws a robot; `record` makes a recording of one rollout, or of several under their names.
# The first is solid, the others are ghosts. Here one second of watching is four seconds of the rollout,
# and 40 frames per second make one frame of each sample.

# %%
with Viewer(robot) as viewer:
    recording = viewer.record(runs, fps=40, speed=4, title="The lecture's circle")
print(recording)

# %% [markdown]
# `save_html` writes the page. It is one file: keep it, send it by mail, open it from the file system. (The
# folder here is deleted again at once; give a name of your own.)

# %%
with TemporaryDirectory() as folder:
    file = recording.save_html(Path(folder) / "circle.html")
    page = file.read_text(encoding="utf-8")
    print(f"{file.name}: {len(page) / 1e6:.1f} MB")

# %% [markdown]
# Most of it is the program that draws. Nothing is fetched from anywhere. A page fetches what its `src` and
# `href` name, so these are looked for, and all web addresses wherever they stand:

# %%
fetched = re.findall(r'<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)="([^"]*)"', page)
addresses = set(re.findall(r"(?:https?|wss?)://[^\s\"'`<>)]+", page))
print("named by src and href:", fetched)
print("web addresses:", sorted(addresses))
print("connects to somebody:", "viewer.connect()" in page)

# %% [markdown]
# `data:,` is an empty icon that the page carries itself. The first address is no request:
# it is how XML writes that an element belongs to HTML. The second one belongs to live viewing: `connect`
# would ask there, and this page never calls it.
#
# In a notebook the page can be put into a frame. A notebook that is kept should be small, though, so this
# object offers both: the page, which is shown when the notebook is run, and a picture, which stays. The
# picture is made by a headless browser; where there is none, the notebook says so and goes on.


# %%
def still(recording, t):
    """Return a picture of a recording at a time [s], or None where there is no Chromium to draw it."""
    with TemporaryDirectory() as folder:
        try:
            return recording.screenshot(f"{folder}/still.png", t=t, size=(640, 420)).read_bytes()
        except ViewerError as error:
            print("No picture:", error)
            return None


class Scene:
    """A recording as a notebook shows it: the page that plays, or else a picture."""

    def __init__(self, recording, t):
        self.page, self.picture = recording.html(), still(recording, t)

    def _repr_html_(self):
        look = "width: 100%; max-width: 900px; height: 560px; border: 0"
        return f'<iframe class="scene" style="{look}" srcdoc="{escape(self.page)}"></iframe>'

    def _repr_png_(self):
        return self.picture


# %% tags=["scene"]
display(Scene(recording, t=20))

# %% [markdown]
# The dashed line is the desired path, the bands are the paths travelled so far. The robot's front is the
# wedge. If this moves, the slider below it chooses the time, and the mouse turns the view. If it does not,
# you are reading the notebook as it is kept: run it.
#
# The ghost is hardly seen, and that is right: 7.5 mm of error are not much beside a robot of 0.6 m. The
# caption tells them apart.
#
# A recording can be kept in other ways, too: `save_gif`, and `save_mp4` for slides (with `pip install
# 'pinmobile[mp4]'`).

# %% [markdown]
# ## Headless
#
# `screenshot` needs no screen. It starts a Chromium without a window, opens the recorded page in it,
# chooses the time, takes the picture and ends it. A Chromium or Chrome that is installed is found; another
# one can be named in the environment variable `PINMOBILE_CHROMIUM`.
#
# ### Frames
#
# The derivation of [notebook 1](01_from_table_to_equations.ipynb) begins with the frames of a DH table.
# There were two tables: the one on the slide, and the one that the lecture computes with. Here are both,
# with the robot at $q = (1.2\ \mathrm{m}, 0.9\ \mathrm{m}, 0.6\ \mathrm{rad})$. Frames that both tables
# share are drawn once. The axes x, y, z are red, green, blue; frames 2 have their origin where the robot
# has its own.

# %%
view = FixedCamera(eye=(0.5, -3.2, 2.6), target=(0.7, 0.6, 0.2))
both = Overlays(frames=(LECTURE_TABLE, SLIDE_TABLE), camera=view)
with Viewer(robot, overlays=both) as viewer, TemporaryDirectory() as folder:
    viewer.display((1.2, 0.9, 0.6))
    try:
        display(Image(viewer.screenshot(f"{folder}/frames.png", size=(640, 420)).read_bytes()))
    except ViewerError as error:
        print("No picture:", error)

# %% [markdown]
# ### Forces, and a camera that follows
#
# To see an error with the naked eye, PD is made twenty times weaker. The robot now runs outside the
# desired pose (the ghost) by about
#
# $$e \approx \frac{r\omega^2}{K_p/m}
# = \frac{0.03\ \mathrm{m/s^2}}{6/30\ \mathrm{1/s^2}} = 0.15\ \mathrm{m} .$$
#
# The arrow is the force of the controller: it pulls inwards, towards the ghost and round the circle. Its
# scale stands in the legend. The camera goes along with the robot, 3 m away.

# %%
weak = simulate(robot, PD((6, 6, 0.4), (6, 6, 0.4)), circle, dt=0.1)
with Viewer(robot) as viewer:
    close = viewer.record(
        weak, fps=10, overlays=Overlays(desired=True, arrows=Arrows(), camera=Follow(distance=3))
    )
picture = still(close, t=40)
if picture:
    display(Image(picture))

# %% [markdown]
# ## Live
#
# `live=True` serves a page from this program. Open `viewer.url` in a browser, and `display` shows a pose in
# it, `play` a whole rollout in real time. The `with` block ends it: the page is served as long as the
# block lasts, and no longer. Nobody has to look: `display` does not wait for a browser.

# %%
with Viewer(robot, live=True) as viewer:
    address = urlsplit(viewer.url)
    print(f"served at {address.scheme}://{address.hostname}, at a port that was free")
    for q in runs["PD"].q[::150]:
        viewer.display(q)
        print("shown: x {:6.3f} m, y {:6.3f} m, psi {:6.3f} rad".format(*q))
    with socket.create_connection((address.hostname, address.port), timeout=5):
        print("somebody listens")

try:
    socket.create_connection((address.hostname, address.port), timeout=5).close()
    left_listening = True
except ConnectionRefusedError:
    left_listening = False
    print("nobody listens any more")

# %% [markdown]
# The address 127.0.0.1 is this machine's own: nobody else on the network can reach the page.
#
# ### On a server
#
# When the program runs on another machine, without a screen, the page is fetched through an SSH tunnel.
# There, choose a port:
#
# ```python
# with Viewer(robot, live=True, port=7100) as viewer:
#     viewer.wait(timeout=300)  # until a browser has come
#     viewer.play(runs, repeat=3)
# ```
#
# Here, in a terminal, with your name and the server's:
#
# ```
# ssh -N -L 7100:127.0.0.1:7100 you@server
# ```
#
# and then open http://127.0.0.1:7100/ in the browser. The tunnel ends with Ctrl-C.

# %% [markdown]
# ## The claim
#
# What is seen is what was computed: in the recording, at every sample, both robots stand where their
# rollouts say. The page asks for nothing from outside, and a viewer that is closed listens no more.

# %%
tracks = {
    (moving["path"], track["name"]): track
    for moving in recording.tracks
    for track in moving["clip"]["tracks"]
}
for number, (name, run) in enumerate(runs.items()):
    position = tracks[f"meshcat/robot{number}", ".position"]
    x, y, z = np.reshape(position["values"], (-1, 3)).T
    quaternion = np.reshape(tracks[f"meshcat/robot{number}", ".quaternion"]["values"], (-1, 4))
    psi = 2 * np.arctan2(quaternion[:, 2], quaternion[:, 3])  # [rad], up to whole turns
    turn = np.abs(np.exp(1j * psi) - np.exp(1j * run.q[:, 2])).max()
    assert np.allclose(position["times"], run.t, atol=1e-4), f"{name}: other times"
    assert np.abs(x - run.q[:, 0]).max() < 1e-5, f"{name}: another x"
    assert np.abs(y - run.q[:, 1]).max() < 1e-5, f"{name}: another y"
    assert turn < 1e-5, f"{name}: another heading"
assert fetched == ["data:,"], "the page fetches something"
assert addresses == {"http://www.w3.org/1999/xhtml", "ws://${location.host}"}, "the page knows others"
assert "viewer.connect()" not in page, "the page connects to somebody"
assert not left_listening, "the closed viewer still listens"
assert 0.12 < np.hypot(*weak.error[400:, :2].T).max() < 0.18, "the weak PD errs by something else"
print("Shown: the recording is the rollout, the page needs no network, and nothing is left listening.")
