"""The camera maker's own recording library (libk4arecord 1.4.2, as it comes inside of the
wheel pyk4a-bundle), by ctypes.

    vendor_k4a.py write FOLDER   recordings of made-up images; what is in them, as JSON
    vendor_k4a.py read FILE      what the library reads in a recording, as JSON

Names, numbers and structures are those of the vendor's headers k4atypes.h, k4arecord.h
and k4arecord_types.h.
"""

import ctypes
import json
import os
import sys
import sysconfig
import time
import zlib
from ctypes import POINTER, Structure, byref, c_bool, c_char_p, c_float, c_int, c_size_t
from ctypes import c_int32, c_uint32, c_uint64, c_uint8, c_void_p
from pathlib import Path

MJPG, NV12, YUY2, BGRA32, DEPTH16, IR16 = range(6)
RES_OFF, RES_720P = 0, 1
MODE_OFF, NFOV_2X2BINNED, NFOV_UNBINNED, WFOV_2X2BINNED, WFOV_UNBINNED, PASSIVE_IR = range(6)
FPS_30 = 2
SUBORDINATE = 2
SIZES = {NFOV_2X2BINNED: (320, 288), NFOV_UNBINNED: (640, 576), PASSIVE_IR: (1024, 1024)}
START_US = 7_654_321
FRAMES = 6
UNCLOSED_S = 2.0


class DeviceConfiguration(Structure):
    _fields_ = [
        ("color_format", c_int),
        ("color_resolution", c_int),
        ("depth_mode", c_int),
        ("camera_fps", c_int),
        ("synchronized_images_only", c_bool),
        ("depth_delay_off_color_usec", c_int32),
        ("wired_sync_mode", c_int),
        ("subordinate_delay_off_master_usec", c_uint32),
        ("disable_streaming_indicator", c_bool),
    ]


class RecordConfiguration(Structure):
    _fields_ = [
        ("color_format", c_int),
        ("color_resolution", c_int),
        ("depth_mode", c_int),
        ("camera_fps", c_int),
        ("color_track_enabled", c_bool),
        ("depth_track_enabled", c_bool),
        ("ir_track_enabled", c_bool),
        ("imu_track_enabled", c_bool),
        ("depth_delay_off_color_usec", c_int32),
        ("wired_sync_mode", c_int),
        ("subordinate_delay_off_master_usec", c_uint32),
        ("start_timestamp_offset_usec", c_uint32),
    ]


class ImuSample(Structure):
    _fields_ = [
        ("temperature", c_float),
        ("acc", c_float * 3),
        ("acc_usec", c_uint64),
        ("gyro", c_float * 3),
        ("gyro_usec", c_uint64),
    ]


def load(name):
    folder = Path(sysconfig.get_path("platlib")) / "pyk4a_bundle.libs"
    (path,) = folder.glob(name)
    return ctypes.CDLL(str(path), ctypes.RTLD_GLOBAL)


load("libudev-*")
SENSOR = load("libk4a-*")
RECORD = load("libk4arecord-*")
for library, name, result in [
    (SENSOR, "k4a_image_get_buffer", c_void_p),
    (SENSOR, "k4a_image_get_size", c_size_t),
    (SENSOR, "k4a_image_get_device_timestamp_usec", c_uint64),
    (SENSOR, "k4a_capture_get_color_image", c_void_p),
    (SENSOR, "k4a_capture_get_depth_image", c_void_p),
    (SENSOR, "k4a_capture_get_ir_image", c_void_p),
    (RECORD, "k4a_playback_get_recording_length_usec", c_uint64),
]:
    getattr(library, name).restype = result


def check(result, what):
    if result != 0:
        sys.exit(f"{what} gives {result}")


def image(kind, size, data, at):
    """An image with a copy of `data`."""
    width, height = size
    handle = c_void_p()
    stride = {DEPTH16: width * 2, IR16: width * 2, BGRA32: width * 4, YUY2: width * 2}
    # The library keeps the buffer until the image is released: it lives to the end.
    buffer = (c_uint8 * len(data)).from_buffer_copy(data)
    BUFFERS.append(buffer)
    create = SENSOR.k4a_image_create_from_buffer
    result = create(
        c_int(kind),
        c_int(width),
        c_int(height),
        c_int(stride.get(kind, width if kind == NV12 else 0)),
        buffer,
        c_size_t(len(data)),
        None,
        None,
        byref(handle),
    )
    check(result, "k4a_image_create_from_buffer")
    SENSOR.k4a_image_set_device_timestamp_usec(handle, c_uint64(at))
    return handle


BUFFERS = []


def noise(seed, count):
    """Bytes that hold every value, different in each image."""
    block = bytes((seed * 131 + n * 7 + (n >> 8)) & 0xFF for n in range(65_521))
    return (block * (count // len(block) + 1))[:count]


def write(path, color, mode, imu=True, flush=True, close=True, apart=33_333):
    config = DeviceConfiguration(
        color_format=MJPG if color is None else color,
        color_resolution=RES_OFF if color is None else RES_720P,
        depth_mode=mode,
        camera_fps=FPS_30,
        wired_sync_mode=SUBORDINATE,
        subordinate_delay_off_master_usec=160,
    )
    record = c_void_p()
    name = str(path).encode()
    check(RECORD.k4a_record_create(name, None, config, byref(record)), "k4a_record_create")
    calibration = b'{"made": "up"}'
    check(
        RECORD.k4a_record_add_attachment(
            record, b"calibration.json", calibration, c_size_t(len(calibration))
        ),
        "k4a_record_add_attachment",
    )
    if imu:
        check(RECORD.k4a_record_add_imu_track(record), "k4a_record_add_imu_track")
    check(RECORD.k4a_record_write_header(record), "k4a_record_write_header")
    told = {"file": path.name, "color": color, "mode": mode, "depth": [], "ir": [], "imu": []}
    size = SIZES[mode]
    next_imu = START_US + 100
    for frame in range(FRAMES):
        at = START_US + frame * apart
        capture = c_void_p()
        check(SENSOR.k4a_capture_create(byref(capture)), "k4a_capture_create")
        if color is not None:
            whole = 1280 * 720
            count = {MJPG: 30_000 + frame, NV12: whole * 3 // 2, YUY2: whole * 2, BGRA32: whole * 4}
            # Colour is exposed at a time of its own.
            picture = image(color, (1280, 720), noise(frame + 90, count[color]), at + 211)
            SENSOR.k4a_capture_set_color_image(capture, picture)
        for kind, key in [(DEPTH16, "depth"), (IR16, "ir")]:
            if kind == DEPTH16 and mode == PASSIVE_IR:
                continue
            data = noise(frame * 2 + kind, size[0] * size[1] * 2)
            picture = image(kind, size, data, at)
            set_image = f"k4a_capture_set_{key}_image"
            getattr(SENSOR, set_image)(capture, picture)
            # The library's images are little-endian, those in the file big-endian.
            swapped = bytearray(data)
            swapped[0::2], swapped[1::2] = data[1::2], data[0::2]
            told[key].append([at, zlib.crc32(swapped)])
        check(RECORD.k4a_record_write_capture(record, capture), "k4a_record_write_capture")
        SENSOR.k4a_capture_release(capture)
        while imu and next_imu < at + apart:
            sample = ImuSample(
                temperature=30.5,
                acc=(0.5, -9.75, next_imu % 1024),
                acc_usec=next_imu,
                gyro=(-0.25, next_imu % 4096, 2.0),
                gyro_usec=next_imu + 37,
            )
            result = RECORD.k4a_record_write_imu_sample(record, sample)
            check(result, "k4a_record_write_imu_sample")
            told["imu"].append(
                [sample.acc_usec, list(sample.acc), sample.gyro_usec, list(sample.gyro)]
            )
            next_imu += 625
    if flush:
        check(RECORD.k4a_record_flush(record), "k4a_record_flush")
    if close:
        RECORD.k4a_record_close(record)
    return told


def read(path):
    playback = c_void_p()
    opened = RECORD.k4a_playback_open(str(path).encode(), byref(playback))
    check(opened, "k4a_playback_open")
    config = RecordConfiguration()
    result = RECORD.k4a_playback_get_record_configuration(playback, byref(config))
    check(result, "k4a_playback_get_record_configuration")
    told = {name: getattr(config, name) for name, _ in RecordConfiguration._fields_}
    told["length"] = RECORD.k4a_playback_get_recording_length_usec(playback)
    for tag in ["K4A_DEVICE_SERIAL_NUMBER", "K4A_DEPTH_MODE"]:
        value = ctypes.create_string_buffer(256)
        count = c_size_t(256)
        result = RECORD.k4a_playback_get_tag(playback, tag.encode(), value, byref(count))
        told[tag] = value.value.decode() if result == 0 else None
    told |= {"color": [], "depth": [], "ir": [], "imu": []}
    capture = c_void_p()
    while True:
        result = RECORD.k4a_playback_get_next_capture(playback, byref(capture))
        if result != 0:
            break
        for key in ["color", "depth", "ir"]:
            picture = c_void_p(getattr(SENSOR, f"k4a_capture_get_{key}_image")(capture))
            if picture:
                data = ctypes.string_at(
                    SENSOR.k4a_image_get_buffer(picture), SENSOR.k4a_image_get_size(picture)
                )
                at = SENSOR.k4a_image_get_device_timestamp_usec(picture)
                told[key].append([at, zlib.crc32(data)])
                SENSOR.k4a_image_release(picture)
        SENSOR.k4a_capture_release(capture)
    # 1 is a failure, 2 the end of the file.
    told["end"] = result
    sample = ImuSample()
    while told["imu_track_enabled"]:
        result = RECORD.k4a_playback_get_next_imu_sample(playback, byref(sample))
        if result != 0:
            told["imu_end"] = result
            break
        told["imu"].append(
            [sample.acc_usec, list(sample.acc), sample.gyro_usec, list(sample.gyro)]
        )
    RECORD.k4a_playback_close(playback)
    return told


def main():
    what, path = sys.argv[1], Path(sys.argv[2])
    if what == "read":
        print(json.dumps(read(path)))
        return
    told = [
        write(path / "mjpg.mkv", MJPG, NFOV_UNBINNED),
        write(path / "nv12.mkv", NV12, NFOV_2X2BINNED),
        write(path / "yuy2.mkv", YUY2, NFOV_2X2BINNED),
        write(path / "bgra.mkv", BGRA32, NFOV_2X2BINNED),
        write(path / "depth_alone.mkv", None, NFOV_2X2BINNED, imu=False),
        write(path / "passive_ir.mkv", None, PASSIVE_IR),
        write(path / "flushed.mkv", None, NFOV_2X2BINNED, close=False),
        # Clusters go to the disk when later ones are seconds ahead.
        write(
            path / "unclosed.mkv", None, NFOV_2X2BINNED, flush=False, close=False, apart=1_000_000
        ),
    ]
    print(json.dumps(told), flush=True)
    # The library's own thread writes clusters to disk; give it the time for some.
    time.sleep(UNCLOSED_S)
    # Unclosed recordings stay so: nothing may tidy up.
    os._exit(0)


main()
