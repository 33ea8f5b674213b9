"""Makes a LeRobot dataset of an extracted data set with smartdepthsync-data, loads it with
LeRobot as training does, compares it with the data set, and asks lerobot-doctor.

usage: check_lerobot.py EUROC
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

# What is not in the folder shall not be looked for elsewhere.
os.environ["HF_HUB_OFFLINE"] = "1"
sys.path.insert(0, str(Path(__file__).parents[4] / "host/data/smartdepthsync-data/src"))

import numpy as np
from PIL import Image
from torch.utils.data import DataLoader

from lerobot.datasets.lerobot_dataset import LeRobotDataset
from smartdepthsync_data import Dataset, DatasetError
from smartdepthsync_data.lerobot import ACTION, DEPTH, PHONE, STATE, to_lerobot

euroc = Path(sys.argv[1])


def own(folder, at):
    return np.array(Image.open(euroc / "mav0" / folder / "data" / f"{at:019}.png"))


def torch_view(dataset):
    batch = next(iter(DataLoader(dataset.torch(), batch_size=4, num_workers=2)))
    for row, at in enumerate(batch["depth_time_ns"].tolist()):
        metres = batch["depth"][row, 0].numpy()
        assert np.abs(1000 * metres - own("depth0", at)).max() < 1e-3
        shown = 255 * batch["image"][row].numpy().transpose(1, 2, 0)
        assert np.abs(shown - own("cam0", int(batch["time_ns"][row]))).max() < 1e-3
    assert batch["sigma_ns"].min() > 0


def loaded(out, episodes):
    dataset = LeRobotDataset("local/recordings", root=out)
    rows = [pair for episode in episodes for pair in episode]
    assert len(dataset) == len(rows) and dataset.num_episodes == len(episodes)
    off = []
    for index in range(3, len(rows), 7):
        item, pair = dataset[index], rows[index]
        assert item["task"] == "walk past the wall"
        assert int(item["phone_time_ns"]) == pair.time_ns
        assert int(item["depth_time_ns"]) == pair.depth_time_ns
        # Whole millimetres, and colours from 0 to 1.
        assert (item[DEPTH].numpy() == own("depth0", pair.depth_time_ns)).all(), index
        seen = 255 * item[PHONE].numpy().transpose(1, 2, 0)
        at = [abs(seen - own("cam0", rows[i].time_ns)).mean() for i in (index - 1, index, index + 1)
              if i < len(rows)]
        off.append(at)
        assert item[STATE].shape == (6,) and item[ACTION].shape == (3,)
    # The video is lossy; the frame before or after is another picture.
    off = np.array([row for row in off if len(row) == 3])
    assert off[:, 1].max() < 8, off
    assert off[:, 1].mean() < min(off[:, 0].mean(), off[:, 2].mean()) - 0.1, off.mean(axis=0)
    # What training normalizes by.
    depths = np.stack([pair.depth_mm for pair in rows]).astype(float)
    stats = {name: float(np.ravel(value)[0]) for name, value in dataset.meta.stats[DEPTH].items()}
    assert abs(stats["mean"] - depths.mean()) < 0.01 * depths.mean(), (stats, depths.mean())
    assert abs(stats["std"] - depths.std()) < 0.02 * depths.std() + 1, (stats, depths.std())
    before = LeRobotDataset("local/recordings", root=out,
                            delta_timestamps={PHONE: [-1 / dataset.fps, 0]})
    batch = next(iter(DataLoader(before, batch_size=8)))
    assert (batch[PHONE][1:, 0] == batch[PHONE][:-1, 1]).all()


def doctor(out):
    program = Path(sys.executable).with_name("lerobot-doctor")
    told = subprocess.run([program, str(out), "--ci"], capture_output=True, text=True)
    assert told.returncode == 0, told.stdout + told.stderr
    checks = json.loads(told.stdout)["checks"]
    said = [message for check in checks for message in check["messages"]]
    worse = [one["message"] for one in said if one["severity"] != "PASS"]
    # The times are taken for nothing that they are not.
    assert not worse, worse
    assert "Found action columns: ['action']" in [one["message"] for one in said]


dataset = Dataset(euroc)
torch_view(dataset)
with tempfile.TemporaryDirectory() as folder:
    out = Path(folder) / "lerobot"
    # The doctor asks for 100 frames each.
    episodes = [dataset[:-5], dataset[5:]]
    assert len(episodes[0]) >= 100
    to_lerobot(episodes, out)
    loaded(out, episodes)
    doctor(out)
    about = json.loads((out / "meta/recordings.json").read_text())
    assert [one["pair_sigma_ns"] for one in about] == [dataset.sigma_ns] * 2
    assert np.allclose(about[0]["cameras"]["phone"]["matrix"], dataset.cameras["phone"].matrix)
    # Not over what is there; and after a failure nothing is left.
    for bad, expected in [({"out": out}, "is there already"),
                          ({"actions": lambda part: (["a"], [[0.0]] * (len(part) - 1))}, "actions")]:
        where = bad.pop("out", Path(folder) / "other")
        try:
            to_lerobot(episodes, where, **bad)
        except DatasetError as error:
            assert expected in str(error)
        else:
            raise AssertionError("it was written")
    assert sorted(path.name for path in Path(folder).iterdir()) == ["lerobot"]
print("ok")
