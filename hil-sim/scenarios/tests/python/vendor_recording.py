"""Writes a depth recording with the camera maker's own library (libk4arecord in the wheel
`pyk4a-bundle`): device times and calibration from outside, made-up pictures.

usage: vendor_recording.py SPEC OUT

SPEC is JSON: `frames` (device times, µs), `depth_mode` and `sync` (numbers of the vendor's
enumerations), `subordinate_us`, `depth_delay_us`, `color` (a JPEG file of 1280 × 720 or
null), `color_us` (colour minus depth), `size` (of the depth images), `calibration` (text
or null).
"""

import ctypes as C
import json
import sys
import sysconfig
from pathlib import Path

spec = json.loads(Path(sys.argv[1]).read_text())
libraries = Path(sysconfig.get_path("purelib")) / "pyk4a_bundle.libs"


def load(name):
    (path,) = libraries.glob(name)
    return C.CDLL(str(path), C.RTLD_GLOBAL)


load("libudev*")
k4a, record = load("libk4a-*"), load("libk4arecord-*")
HANDLE = C.c_void_p


class Configuration(C.Structure):
    _fields_ = [("color_format", C.c_int), ("color_resolution", C.c_int), ("depth_mode", C.c_int),
                ("fps", C.c_int), ("synchronized_only", C.c_bool), ("depth_delay", C.c_int32),
                ("sync", C.c_int), ("subordinate_delay", C.c_uint32), ("no_led", C.c_bool)]


def call(library, name, *args):
    result = getattr(library, name)(*args)
    assert result == 0, f"{name}: {result}"


def image(image_format, width, height, us, content):
    made = HANDLE()
    if image_format == 0:
        buffer = C.create_string_buffer(content, len(content))
        keep.append(buffer)
        release = C.CFUNCTYPE(None, C.c_void_p, C.c_void_p)()
        call(k4a, "k4a_image_create_from_buffer", 0, width, height, 0, buffer,
             C.c_size_t(len(content)), release, None, C.byref(made))
    else:
        call(k4a, "k4a_image_create", image_format, width, height, width * 2, C.byref(made))
        k4a.k4a_image_get_buffer.restype = C.c_void_p
        C.memmove(k4a.k4a_image_get_buffer(made), content, len(content))
    k4a.k4a_image_set_device_timestamp_usec(made, C.c_uint64(us))
    return made


keep = []
jpeg = Path(spec["color"]).read_bytes() if spec["color"] else None
configuration = Configuration(0, 1 if jpeg else 0, spec["depth_mode"], 2, False,
                              spec["depth_delay_us"], spec["sync"], spec["subordinate_us"], False)
out = HANDLE()
record.k4a_record_create.argtypes = [C.c_char_p, HANDLE, Configuration, C.POINTER(HANDLE)]
call(record, "k4a_record_create", sys.argv[2].encode(), None, configuration, C.byref(out))
if spec["calibration"]:
    text = spec["calibration"].encode()
    call(record, "k4a_record_add_attachment", out, b"calibration.json", text, C.c_size_t(len(text)))
call(record, "k4a_record_write_header", out)
width, height = spec["size"]
for number, us in enumerate(spec["frames"]):
    capture = HANDLE()
    call(k4a, "k4a_capture_create", C.byref(capture))
    # Format 4 is depth.
    pixels = (1000 + number).to_bytes(2, "little") * (width * height)
    images = [("depth", image(4, width, height, us, pixels))]
    if jpeg:
        images.append(("color", image(0, 1280, 720, us + spec["color_us"], jpeg)))
    for kind, made in images:
        getattr(k4a, f"k4a_capture_set_{kind}_image")(capture, made)
        k4a.k4a_image_release(made)
    call(record, "k4a_record_write_capture", out, capture)
    k4a.k4a_capture_release(capture)
call(record, "k4a_record_flush", out)
record.k4a_record_close(out)
