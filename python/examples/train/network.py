"""The network, the same for every input but for its first layer's number of channels, and its training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from clips import Clip
from inputs import Sparse

#: Pixels that the first layer makes one of, in each direction.
PATCH = 4
#: Sides of a picture are filled up to a multiple of this.
MULTIPLE = 4 * PATCH
WIDTH = 16
#: Scaled values are cut to this.
VALUE_MAX = 8.0
CROP = 128
BATCH = 8
LEARNING_RATE = 8e-3

Scale = dict[str, torch.Tensor]


def _convolution(of: int, to: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(of, to, 3, stride, 1), nn.GroupNorm(4, to), nn.ReLU())


class Active(NamedTuple):
    """The active pixels of one kind in a batch of pictures."""

    #: Scaled, (N, C), those of equal places in their patches together.
    values: torch.Tensor
    #: The patch of each among all patches of the batch.
    patches: torch.Tensor
    #: How many pixels there are of each place in a patch.
    counts: list[int]


class Batch(NamedTuple):
    """Pictures of one size as their active pixels: all others are 0, and would take most of the time."""

    pictures: int
    #: Rows and columns of patches.
    sides: tuple[int, int]
    active: dict[str, Active]


class Net(nn.Module):
    """A U-Net of three levels, on patches of 4 x 4 pixels: masks of whole pixels as logits.

    Each kind of array that an input has, one for each transform that density chooses among, has a first layer of its own;
    all others are shared. The first layer is a convolution of 4 x 4 in steps of 4.
    """

    def __init__(self, channels: dict[str, int]) -> None:
        super().__init__()
        # First, so that every input's network begins with the same values there.
        self.top = nn.Sequential(nn.ReLU(), _convolution(WIDTH, WIDTH))
        self.middle = nn.Sequential(_convolution(WIDTH, 2 * WIDTH, 2), _convolution(2 * WIDTH, 2 * WIDTH))
        self.bottom = nn.Sequential(_convolution(2 * WIDTH, 2 * WIDTH, 2), _convolution(2 * WIDTH, 2 * WIDTH))
        self.up = _convolution(4 * WIDTH, 2 * WIDTH)
        self.out = nn.Sequential(
            _convolution(3 * WIDTH, WIDTH), nn.Conv2d(WIDTH, PATCH * PATCH, 1), nn.PixelShuffle(PATCH)
        )
        # Few pixels move.
        nn.init.constant_(self.out[1].bias, -3.0)
        self.bias = nn.Parameter(torch.zeros(WIDTH))
        self.first = nn.ParameterDict()
        for kind, count in channels.items():
            most = (count * PATCH * PATCH) ** -0.5
            self.first[kind] = nn.Parameter(torch.empty(PATCH * PATCH, count, WIDTH).uniform_(-most, most))

    def forward(self, batch: Batch) -> torch.Tensor:
        """Returns logits (N, H, W)."""
        height, width = batch.sides
        made = self.bias.expand(batch.pictures * height * width, WIDTH)
        for kind, active in batch.active.items():
            parts = zip(torch.split(active.values, active.counts), self.first[kind])
            made = made.index_add(0, active.patches, torch.cat([values @ weights for values, weights in parts]))
        top = self.top(made.reshape(batch.pictures, height, width, WIDTH).permute(0, 3, 1, 2).contiguous())
        middle = self.middle(top)
        bottom = functional.interpolate(self.bottom(middle), scale_factor=2.0)
        up = functional.interpolate(self.up(torch.cat([bottom, middle], 1)), scale_factor=2.0)
        logits: torch.Tensor = self.out(torch.cat([up, top], 1)).squeeze(1)
        return logits


def scale_of(samples: Sequence[Sparse], channels: dict[str, int]) -> Scale:
    """Returns the root mean square of each channel over the active pixels: one rule for every input."""
    scale = {}
    for kind, count in channels.items():
        of_kind = [sample.values for sample in samples if sample.kind == kind]
        squares = sum((np.square(values, dtype=np.float64).sum(0) for values in of_kind), np.zeros(count))
        pixels = sum(len(values) for values in of_kind)
        root = np.sqrt(squares / max(1, pixels))
        # A channel that is always 0 stays so.
        scale[kind] = torch.from_numpy(np.where(root > 0, root, 1.0).astype(np.float32))
    return scale


class Placed(NamedTuple):
    """Active pixels of one picture and where they are in it."""

    kind: str
    values: Any
    x: Any
    y: Any


def batch_of(pictures: Sequence[Placed], sides: tuple[int, int], scale: Scale) -> Batch:
    """Scales and orders the active pixels of pictures of `sides` rows and columns."""
    height, width = sides[0] // PATCH, sides[1] // PATCH
    active = {}
    for kind in sorted({picture.kind for picture in pictures}):
        of_kind = [(number, picture) for number, picture in enumerate(pictures) if picture.kind == kind]
        patches = [(n * height + one.y // PATCH) * width + one.x // PATCH for n, one in of_kind]
        inner = np.concatenate([one.y % PATCH * PATCH + one.x % PATCH for _, one in of_kind])
        order = np.argsort(inner, kind="stable")
        values = torch.from_numpy(np.concatenate([one.values for _, one in of_kind])[order])
        active[kind] = Active(
            (values / scale[kind]).clamp_(-VALUE_MAX, VALUE_MAX),
            torch.from_numpy(np.concatenate(patches)[order]),
            np.bincount(inner, minlength=PATCH * PATCH).tolist(),
        )
    return Batch(len(pictures), (height, width), active)


@dataclass(frozen=True)
class Cut:
    """A square of a window that is turned in one of eight ways."""

    clip: int
    window: int
    x: int
    y: int
    way: int

    def turned(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Returns the places in the square of pixels of the window."""
        x, y = x - self.x, y - self.y
        if self.way & 1:
            x = CROP - 1 - x
        if self.way & 2:
            y = CROP - 1 - y
        return (y, x) if self.way & 4 else (x, y)


def cuts(clips: Sequence[Clip], count: int, seed: int) -> list[Cut]:
    """Draws squares, every fourth one around a pixel of a moving object: the same for every input."""
    random = np.random.default_rng(seed)
    with_objects = [(i, j) for i, clip in enumerate(clips) for j in range(clip.count) if clip.masks[j].any()]
    made = []
    for number in range(count):
        if number % 4 == 0 and with_objects:
            clip, window = with_objects[random.integers(len(with_objects))]
            pixels = np.argwhere(clips[clip].masks[window])
            y, x = pixels[random.integers(len(pixels))] - random.integers(0, CROP, 2)
        else:
            clip = int(random.integers(len(clips)))
            window = int(random.integers(clips[clip].count))
            x, y = random.integers(-CROP // 4, np.array(clips[clip].sensor) - CROP * 3 // 4)
        made.append(Cut(clip, window, int(x), int(y), int(random.integers(8))))
    return made


def _square(sample: Sparse, width: int, cut: Cut) -> Placed:
    x, y = cut.turned(sample.places % width, sample.places // width)
    inside = (x >= 0) & (x < CROP) & (y >= 0) & (y < CROP)
    return Placed(sample.kind, sample.values[inside], x[inside], y[inside])


def _square_mask(mask: Any, cut: Cut) -> torch.Tensor:
    square = np.zeros((CROP, CROP), np.float32)
    y, x = np.nonzero(mask)
    x, y = cut.turned(x, y)
    inside = (x >= 0) & (x < CROP) & (y >= 0) & (y < CROP)
    square[y[inside], x[inside]] = 1
    return torch.from_numpy(square)


def loss_of(logits: torch.Tensor, masks: torch.Tensor) -> torch.Tensor:
    """Returns the mean cross entropy plus one minus the soft Dice coefficient of the batch."""
    shares = torch.sigmoid(logits)
    dice = (2 * (shares * masks).sum() + 1) / (shares.sum() + masks.sum() + 1)
    loss: torch.Tensor = functional.binary_cross_entropy_with_logits(logits, masks) + 1 - dice
    return loss


def train(
    clips: Sequence[Clip], samples: Sequence[Sequence[Sparse]], channels: dict[str, int], scale: Scale, steps: int, seed: int
) -> Net:
    """Trains a network: Adam, a learning rate that falls to 0 as a cosine, squares by the seed."""
    torch.manual_seed(seed)
    net = Net(channels)
    optimizer = torch.optim.Adam(net.parameters(), LEARNING_RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    drawn = cuts(clips, steps * BATCH, seed)
    for step in range(steps):
        batch = drawn[step * BATCH : (step + 1) * BATCH]
        squares = [_square(samples[cut.clip][cut.window], clips[cut.clip].sensor[0], cut) for cut in batch]
        masks = torch.stack([_square_mask(clips[cut.clip].masks[cut.window], cut) for cut in batch])
        loss = loss_of(net(batch_of(squares, (CROP, CROP), scale)), masks)
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()
        schedule.step()
    return net


def masks(nets: Sequence[Net], samples: Sequence[Sparse], sensor: tuple[int, int], scale: Scale) -> Any:
    """Returns what the networks say of each window: (networks, windows, H, W) of bool."""
    width, height = sensor
    sides = (-(-height // MULTIPLE) * MULTIPLE, -(-width // MULTIPLE) * MULTIPLE)
    made = np.empty((len(nets), len(samples), height, width), bool)
    with torch.no_grad():
        for index, sample in enumerate(samples):
            picture = Placed(sample.kind, sample.values, sample.places % width, sample.places // width)
            batch = batch_of([picture], sides, scale)
            for number, net in enumerate(nets):
                made[number, index] = (net(batch)[0, :height, :width] > 0).numpy()
    return made
