"""Frames as a GIF or a film."""

import importlib
import tempfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from pinmobile.errors import ViewerError
from pinmobile.extras import installing

__all__ = ["film", "film_encoder", "gif"]

_HELD = 1.0  # [s] for which the last frame stands
_COLOURS = 128
_SAMPLED = 8  # frames whose colours a GIF has


def gif(frames: Iterator[Image.Image], rate: float) -> bytes:
    """Return a GIF, all frames in the colours of some from its beginning to its end.

    Parameters
    ----------
    frames : iterator of Image
        All of one size.
    rate : float
        Frames per second.
    """
    pictures = list(frames)  # not decoded yet: some ten kilobytes each
    sampled = [pictures[k] for k in np.unique(np.linspace(0, len(pictures) - 1, _SAMPLED).astype(int))]
    width, height = pictures[0].size
    mosaic = Image.new("RGB", (width, height * len(sampled)))
    for k, picture in enumerate(sampled):
        mosaic.paste(picture.convert("RGB"), (0, height * k))
    palette = mosaic.quantize(_COLOURS, dither=Image.Dither.NONE)
    images = [p.convert("RGB").quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures]
    ticks = np.round(100 * np.arange(len(images) + 1) / rate).astype(int)
    durations = [int(10 * tick) for tick in np.diff(ticks)]
    durations[-1] = round(1000 * _HELD)
    buffer = BytesIO()
    images[0].save(buffer, "GIF", save_all=True, append_images=images[1:], duration=durations, loop=0)
    return buffer.getvalue()


def film_encoder() -> Any:
    """Return imageio-ffmpeg, of the extra ``pinmobile[mp4]``.

    Raises
    ------
    ViewerError
        If it is not installed.
    """
    try:
        return importlib.import_module("imageio_ffmpeg")
    except ImportError:
        raise ViewerError(
            f"a film needs imageio-ffmpeg, which is not installed: {installing('mp4')}"
        ) from None


def film(encoder: Any, frames: Iterator[Image.Image], rate: float, size: tuple[int, int]) -> bytes:
    """Return a film (MP4).

    Parameters
    ----------
    encoder : module
        As `film_encoder` returns it.
    frames : iterator of Image
        All of the size.
    rate : float
        Frames per second.
    size : tuple of 2 int
        Width and height [px], even.
    """
    with tempfile.TemporaryDirectory(prefix="pinmobile-") as folder:
        file = Path(folder) / "film.mp4"
        writer = encoder.write_frames(str(file), size, fps=rate, macro_block_size=2, ffmpeg_log_level="error")
        writer.send(None)
        try:
            for frame in frames:
                writer.send(frame.convert("RGB").tobytes())
        finally:
            writer.close()
        return file.read_bytes()
