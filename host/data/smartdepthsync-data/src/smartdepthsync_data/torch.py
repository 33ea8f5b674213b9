"""View of a data set for PyTorch's loaders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch.utils.data import Dataset as _TorchBase

from .samples import Pair


class TorchDataset(_TorchBase):
    """Pairs as tensors.

    Each item has ``image`` (3, height, width) from 0 to 1; ``depth`` (1, height, width) in metres,
    0 where there is none; ``time_ns`` and ``depth_time_ns`` as integers; ``sigma_ns``, NaN if
    unknown.
    """

    def __init__(self, dataset: Sequence[Pair]):
        self.dataset = dataset

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, index: int) -> dict[str, Any]:
        pair = self.dataset[index]
        sigma = float("nan") if pair.sigma_ns is None else pair.sigma_ns
        return {
            "image": torch.from_numpy(pair.image).permute(2, 0, 1).float() / 255,
            "depth": torch.from_numpy(pair.depth)[None],
            "time_ns": pair.time_ns,
            "depth_time_ns": pair.depth_time_ns,
            "sigma_ns": sigma,
        }
