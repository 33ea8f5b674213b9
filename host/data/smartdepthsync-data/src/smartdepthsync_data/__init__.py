"""Data sets that ``smartdepthsync extract`` writes.

:class:`Dataset` opens one. :mod:`smartdepthsync_data.lerobot` makes a LeRobot dataset of
several, and :mod:`smartdepthsync_data.fleet` extracts every recording of a store.
"""

from .dataset import Camera, Dataset, DatasetError, Imu, Pair, sequences

__all__ = ["Camera", "Dataset", "DatasetError", "Imu", "Pair", "sequences"]
