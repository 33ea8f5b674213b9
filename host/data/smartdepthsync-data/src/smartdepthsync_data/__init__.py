"""Data sets that ``smartdepthsync extract`` writes.

:class:`Dataset` opens one. :mod:`smartdepthsync_data.lerobot` converts several to a LeRobot
dataset, and :mod:`smartdepthsync_data.fleet` extracts every recording of a store.
"""

from .dataset import Dataset, DatasetError, sequences
from .samples import Camera, Imu, Pair

__all__ = ["Camera", "Dataset", "DatasetError", "Imu", "Pair", "sequences"]
