"""A client of the app's remote control that reads as the app's published one does.

Written for this project from the protocol's description. It shares with the
published client what a phone must get right: an empty line behind each
`imu?...`, a new buffered reader for each request which is thrown away with
whatever it has read too much, counted lines instead of reading to `end` (three
sensors, three lines of `video_start`), unbuffered lines before a video.

Usage: phone_client.py HOST PORT VERSION
"""

import socket
import sys


class Phone:
    def __init__(self, host, port, version):
        self.version = version
        self.sock = socket.create_connection((host, port), timeout=60)

    def _begin(self, reader):
        status = reader.readline().rstrip("\n")
        version = reader.readline().rstrip("\n")
        assert version == self.version, f"version {version!r} after status {status!r}"
        if status == "ERROR":
            raise RuntimeError(reader.readline().rstrip("\n"))
        assert status == "SUCCESS", status

    def _ask(self, text):
        stream = self.sock.makefile("rw")
        stream.write(text + "\n")
        stream.flush()
        self._begin(stream)
        return stream

    def imu(self, milliseconds, accel, gyro, magnetic):
        flags = tuple(int(wanted) for wanted in (accel, gyro, magnetic))
        stream = self._ask(
            "imu?duration=%d&accel=%d&gyro=%d&magnetic=%d\n" % ((milliseconds,) + flags)
        )
        files = {}
        for _ in range(3):
            name = stream.readline().rstrip("\n")
            if name == "end":
                break
            rows = []
            line = stream.readline()
            while line.rstrip("\n") != "sensor_end":
                rows.append(line)
                line = stream.readline()
            files[name] = rows
        stream.close()
        return files

    def start(self):
        stream = self._ask("video_start")
        phase = int(stream.readline())
        duration = float(stream.readline())
        exposure = None
        if self.version != "v.0.1":
            exposure = int(stream.readline())
        assert stream.readline() == "end\n"
        return phase, duration, exposure

    def stop(self):
        stream = self._ask("video_stop")
        while stream.readline().rstrip("\n") != "end":
            pass

    def video(self):
        stream = self.sock.makefile("rwb", 0)
        stream.write(b"get_video\n")
        lines = [stream.readline().decode().rstrip("\n") for _ in range(5)]
        assert lines[0] == "SUCCESS" and lines[4] == "end", lines
        stream.close()
        size, name = int(lines[2]), lines[3]
        data = b""
        while len(data) < size:
            more = self.sock.recv(4096)
            assert more, "the phone left"
            data += more
        return name, data


def main():
    host, port, version = sys.argv[1], int(sys.argv[2]), sys.argv[3]
    phone = Phone(host, port, version)
    # Each combination leaves the stray answer in another place of the stream.
    for wanted in [
        (False, True, False),
        (True, True, False),
        (True, True, True),
        (True, False, True),
        (False, False, False),
        (False, True, False),
    ]:
        files = phone.imu(1000, *wanted)
        assert len(files) == sum(wanted), (wanted, list(files))
        for name, rows in files.items():
            expected = 100 if name.endswith("magnetic.csv") else 500
            assert abs(len(rows) - expected) < 0.05 * expected, (name, len(rows))
            for row in rows:
                x, y, z, ns = row.split(",")
                float(x), float(y), float(z), int(ns)
    phase, duration, exposure = phone.start()
    assert phase > 0 and abs(duration - 33.33e6) < 1e5, (phase, duration)
    assert (exposure is None) == (version == "v.0.1"), exposure
    phone.stop()
    assert phone.imu(500, False, True, False)
    name, data = phone.video()
    assert name.endswith(".mp4") and data[4:8] == b"ftyp", (name, data[:16])
    phone.stop()
    phone.start()
    try:
        phone.imu(500, False, True, False)
    except RuntimeError as error:
        assert str(error) == "Error in IMU recording", error
    else:
        raise AssertionError("the phone is busy and did not say so")
    print("good:", len(data), "bytes of video, phase", phase)


if __name__ == "__main__":
    main()
