"""`smartdepthsync sync` on bags that public tools have written from the real twist.

SMARTDEPTHSYNC names the program.
"""

import json
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[3]
REAL = ROOT / "host/twist-scenarios/data/twist"
MAKE_BAG = ROOT / "hil-sim/scenarios/tests/python/make_published_bag.py"


def run(*args):
    return subprocess.run([os.environ["SMARTDEPTHSYNC"], *args], capture_output=True, text=True)


class Bags(unittest.TestCase):
    def test_bags_give_what_the_csv_gives(self):
        phone = REAL / "smartphone_gyro_data.csv"
        expected = json.loads(
            run("offset", "--json", "--mcu", REAL / "mcu_gyro_data.csv", "--phone", phone).stdout
        )
        with tempfile.TemporaryDirectory() as folder:
            folder = pathlib.Path(folder)
            subprocess.run([sys.executable, MAKE_BAG, REAL, folder, "bz2"], check=True)
            ros1 = folder / "published.bag"
            refusal = run("sync", ros1, phone).stderr
            command = refusal.split("`")[1].split()
            self.assertEqual(command[0], "rosbags-convert", refusal)
            subprocess.run([sys.executable, "-m", "rosbags.convert", *command[1:]], check=True)
            converted = folder / "published-mcap"
            for bag in (converted, converted / "published-mcap.mcap"):
                pair = json.loads(run("sync", "--json", bag, phone).stdout)["pairs"][0]
                self.assertLess(abs(pair["offset_ns"] - expected["offset_s"] * 1e9), 2, bag)
                self.assertLess(abs(pair["offset_sigma_us"] - expected["offset_sigma_s"] * 1e6), 0.1)


if __name__ == "__main__":
    unittest.main()
