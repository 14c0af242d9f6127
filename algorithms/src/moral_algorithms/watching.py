"""An episode as a moving picture."""

from __future__ import annotations

import importlib
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from moral_algorithms.evaluation import Policy
from moral_algorithms.learners.ppo import sampling_seed
from moral_algorithms.storage import atomic_write
from moral_envs.engine import Engine
from moral_envs.rendering import MIN_TILE, draw_rgb
from moral_envs.streams import spawn_streams
from moral_envs.world import World

Frames = list[NDArray[np.uint8]]

FORMATS = (".gif", ".mp4")
"""What a picture's name can end with."""

_SIZE = 448
_CAPTION_HEIGHT = 64
_INK, _PAPER = (38, 42, 50), (245, 244, 240)
# How long the last frame stays, in frames.
_LAST = 10


def require_format(path: Path, fps: int) -> None:
    """Raise an error unless a picture can be written under that name.

    Raises
    ------
    ValueError
        If the name does not end with one of :data:`FORMATS`, the encoder for MP4 is not installed, or ``fps``
        is not 1 to 50.
    """
    if path.suffix.lower() not in FORMATS:
        raise ValueError(f"out is {path}; its name must end with {' or '.join(FORMATS)}")
    if not 1 <= fps <= 50:
        raise ValueError(f"fps is {fps}; it must be 1 to 50")
    if path.suffix.lower() == ".mp4":
        try:
            importlib.import_module("imageio_ffmpeg")
        except ImportError as error:
            raise ValueError(
                f"out is {path}; MP4 needs an encoder: pip install 'moral-algorithms[video]', or take a .gif"
            ) from error


def film(
    policy: Policy, world: World, seed: int, deterministic: bool = False
) -> tuple[Frames, dict[str, int]]:
    """Play one episode.

    Parameters
    ----------
    policy
        Chooses the actions.
    world
        The rules.
    seed
        Entropy of start and actions.
    deterministic
        Take the likeliest action instead of sampling.

    Returns
    -------
    frames : list of uint8 arrays of shape (height, width, 3)
        The start and the state after each step, captioned with the objectives so far.
    objectives : dict of str to int
        The counters at the end.
    """
    engine = Engine(world, 1)
    engine.seed(spawn_streams(seed, 1))
    engine.reset()
    frames = [_frame(engine, 0)]
    with sampling_seed(seed):
        for step in range(1, world.horizon + 1):
            actions, _ = policy.predict(engine.observe()[:, 0], deterministic=deterministic)
            engine.step(actions)
            frames.append(_frame(engine, step))
    return frames, dict(zip(world.objective_names, engine.objectives[0, 0].tolist(), strict=True))


def write_film(path: Path, frames: Frames, fps: int) -> None:
    """Write frames as a GIF or an MP4, by the name's end.

    Raises
    ------
    ValueError
        As in :func:`require_format`.
    StorageError
        If it cannot be written.
    """
    require_format(path, fps)
    if path.suffix.lower() == ".gif":
        first, *others = [Image.fromarray(frame) for frame in frames]
        durations = [1000 // fps] * len(others) + [1000 * _LAST // fps]
        with atomic_write(path) as file:
            first.save(file, "GIF", save_all=True, append_images=others, duration=durations, loop=0)
        return
    content = _encode_mp4([*frames, *[frames[-1]] * (_LAST - 1)], fps)
    with atomic_write(path) as file:
        file.write(content)


def _encode_mp4(frames: Frames, fps: int) -> bytes:
    encoder = importlib.import_module("imageio_ffmpeg")
    height, width, _ = frames[0].shape
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        # Players want even sizes, which these are; the default rounds them up to multiples of 16.
        writer = encoder.write_frames(str(path), (width, height), fps=fps, macro_block_size=2)
        writer.send(None)
        for frame in frames:
            writer.send(frame)
        writer.close()
        return path.read_bytes()


def _frame(engine: Engine, step: int) -> NDArray[np.uint8]:
    world = engine.world
    # Even, so that the picture's sides are.
    tile = max(MIN_TILE, _SIZE // max(world.height, world.width) // 2 * 2)
    picture = draw_rgb(world, engine.world_planes()[0], engine.agent_cells[0], tile)
    caption = Image.new("RGB", (picture.shape[1], _CAPTION_HEIGHT), _PAPER)
    draw = ImageDraw.Draw(caption)
    counters = zip(world.objective_names, engine.objectives[0, 0].tolist(), strict=True)
    draw.text((12, 8), f"step {step} of {world.horizon}", _INK, ImageFont.load_default(20))
    draw.text(
        (12, 36), "   ".join(f"{name} {count}" for name, count in counters), _INK, ImageFont.load_default(16)
    )
    return np.concatenate([picture, np.asarray(caption)])
