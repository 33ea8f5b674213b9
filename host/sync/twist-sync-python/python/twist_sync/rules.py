"""Rules by which columns are understood: one page, to be extended by a word or a row.

1. `KINDS` and `UNITS`: what a column measures, by the words of its name and by its unit.
2. Columns of one name but for the axis (`AXES`, `SPOKEN`) are a group: three axes, a quaternion, a
   matrix.
3. `TIMES`: of several columns of times the sensor's own precedes that of its arrival.
4. `UNNAMED` and `MAKERS`: columns of files without names, units of makers that write none.

A layout that is not read yet: a word in one of these, and a file in `tests/layouts.py`.
"""

from __future__ import annotations

import re

import numpy as np

#: rad/s in one of each.
RATE_UNITS = {
    "rad/s": 1.0,
    "mrad/s": 1e-3,
    "deg/s": np.pi / 180,
    "mdps": np.pi / 180e3,
    "rpm": np.pi / 30,
}
#: Nanoseconds in one of each.
TIME_UNITS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
#: The same of units that files name and no option does.
MORE_TIME = {**TIME_UNITS, "0.1 ms": 10**5, "min": 60 * 10**9, "h": 3600 * 10**9, "days": 86400 * 10**9}

#: Quantity and name of a unit, and its spelling without spaces, signs of powers and
#: products; a factor may precede it.
UNITS = (
    ("rate", "rad/s", r"rad(ian)?s?(/s|s-1|ps|persec)(ec|econds?)?"),
    ("rate", "mrad/s", r"mrad(/s|s-1)(ec)?"),
    ("rate", "deg/s", r"(deg|degrees?|°|º|d)(/s|s-1|ps|s|persec)(ec|econds?)?"),
    ("rate", "mdps", r"m(illi)?d(eg)?(/s|ps)"),
    ("rate", "rpm", r"rpm|rev/min"),
    ("rate", "0.01 deg/s", r"c(enti)?d(eg)?(/s|ps)"),
    ("counts", "", r"lsb|counts?|digits?|raw"),
    ("time", "s", r"s|secs?|seconds?"),
    ("time", "ms", r"ms|msecs?|millis(ec(ond)?s?)?|milliseconds?"),
    ("time", "us", r"us|usecs?|micros(ec(ond)?s?)?|microseconds?"),
    ("time", "ns", r"ns|nsecs?|nanos(ec(ond)?s?)?|nanoseconds?"),
    ("time", "min", r"min|minutes"),
    ("time", "h", r"h|hours"),
    ("time", "days", r"days"),
    ("angle", "rad", r"rad(ian)?s?"),
    ("angle", "deg", r"deg|degrees?|°|º"),
    ("acceleration", "", r"m/?/?s(ec)?-?2|m/s/s|m?g|mss|gs"),
    ("other", "", r"[umn]?t(esla)?|m?gauss|ga|m|mm|cm|met(er|re)s?|°?c|degc|h?pa|k|v|m?v|hz|m/s|a\.?u\.?|lx|%"),
)  # fmt: skip

#: Quantity of a group of columns, by words of its name and of its table's; the first wins.
KINDS = (
    (
        "other",
        r"bias|cov(ariance)?|variance|std|setpoint|desired|target|integral|delta|error|residual|noise|temp"
        r"|unfilt|offset|velocity increment|angular (accel\w*|position|displacement)|b w|dq|dv|mean|max|min|deriv\w*|dot|jerk",
    ),
    ("angles", r"gyr\w* (ang|angles?|heading|attitude|euler)"),
    (
        "rate",
        r"\w*gyr\w*|giros?c\w*|angular ?(vel\w*|rates?)|angularvel\w*|ang ?vel\w*|vel ang|omega|rotation ?rates?|rot ?rate"
        r"|rates?|w|av|alpha|rollspeed|pitchspeed|yawspeed|as|(body )?rates?|turn ?rates?|gy?",
    ),
    ("orientation", r"\w*quat\w*|q|orient\w*|rotation|rot|pose|attitude|rotmat|matrix|r|game rotation vector"),
    ("acceleration", r"\w*acc\w*|beschl\w*|gravity|linear|user|specific force|gf|g ?f|ac?|lin|baro|lowg|highg"),
    ("magnetic", r"\w*mag\w*|compass|m|b|\w*field"),
    ("angles", r"euler|roll|pitch|yaw|angles?|heading"),
    ("position", r"pos\w*|translation|p|t|location|velocity|vel|v|speed|gps|lat|lon|marker"),
)  # fmt: skip
#: Rank of a column of times by words of its name: the clock that stamped the sample first.
TIMES = (
    (9, r"phone|host|arriv\w*|rece?i?v\w*|rx|pc|app|logging|log time|publish|saved|sys|system|computer|date|week"),
    (0, r"header ?stamp|sensor|hw|hardware|device|sample|cts|since ?reboot|boot"),
    (5, r"ticks?|cycles?"),
    (2, r"epoch|unix|utc"),
    (1, r"time ?stamps?|stamp|time|timens|timeus|timems|gpst|tow|zeit|temps|tiempo|tempo|clock|t"),
    (2, r"ts|elapsed|uptime|nanos\w*|micros\w*|millis\w*|ns|us|ms|nsec|usec|msec"),
    (3, r"secs?|seconds?|s|since"),
)  # fmt: skip
#: Durations, which are times of no clock.
DURATION = re.compile(r"\b(dt|duration|exposure|latency|interval|period|offset(?! time)|delay|gps accuracy)\b")
#: Rates that are not those of samples, or of another sensor's.
OTHER_RATE = re.compile(r"\b(baud|bit|heart|pulse|refresh|gps|mag\w*|acc\w*|video|audio)\b")
COUNTER = re.compile(r"\b(packet ?counter|counter|count|sample ?(no|number|count\w*)?|index|frame|seq|f|row|n)\b")
#: A column that tells sensors or bodies apart.
SENSOR = re.compile(r"(sensor|device|dev|node|imu|unit|instance|type|name|topic|id|i|addr\w*|mac|body|source|location)"
                     r"( ?(id|no|nr|num|number|index|instance|type|name))?")  # fmt: skip

#: Columns of files without names, by their number; "" is a column of words. Orientations are
#: taken if their size is that of one, and rates by what remains.
UNNAMED = {
    # rosidl_runtime_py message_to_csv of sensor_msgs/Imu.
    40: "sec nanosec frame orientation.x orientation.y orientation.z orientation.w".split()
    + [f"orientation_covariance {k}" for k in range(9)]
    + [f"angular_velocity.{k} (rad/s)" for k in "xyz"]
    + [f"angular_velocity_covariance {k}" for k in range(9)]
    + [f"linear_acceleration.{k}" for k in "xyz"]
    + [f"linear_acceleration_covariance {k}" for k in range(9)],
    # The same of geometry_msgs/PoseStamped and Vector3Stamped.
    10: "sec nanosec frame position.x position.y position.z orientation.x orientation.y orientation.z orientation.w".split(),
    6: "sec nanosec frame vector.x vector.y vector.z".split(),
    # TUM's trajectories: <https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats>.
    8: "timestamp tx ty tz qx qy qz qw".split(),
    # ARKit Data Logger: <https://github.com/PyojinKim/ARKit-Data-Logger>.
    13: ["timestamp", *(f"r{r}{c}" for r in range(3) for c in "012t")],
    17: ["timestamp", *(f"r{r}{c}" for r in range(4) for c in range(4))],
    # Poses of KITTI's odometry: rows of a matrix (3, 4).
    12: [f"r{r}{c}" for r in range(3) for c in "012t"],
}

#: Units of makers that write none: columns, what is set above them, unit of the rates.
MAKERS = (
    ("MT Manager", {"packetcounter", "gyr_x"}, {"update rate"}, "rad/s"),
    ("Xsens DOT", {"sampletimefine", "gyr_x"}, set(), "deg/s"),
    ("Sensor Logger", {"seconds_elapsed", "x", "y", "z"}, set(), "rad/s"),
    ("Physics Toolbox", {"time", "wx", "wy", "wz"}, set(), "rad/s"),
    ("Stray Scanner", {"timestamp", "alpha_x", "alpha_y", "alpha_z"}, set(), "rad/s"),
    ("ArduPilot", {"timeus", "gyrx", "gyry", "gyrz"}, set(), "rad/s"),
    ("Betaflight", {"loopiteration", "gyroadc[0]"}, set(), "deg/s"),
    ("RealSense", {"hw timestamp (ms)", "3dof_x"}, set(), "rad/s"),
    ("ROS", {"field.angular_velocity.x"}, set(), "rad/s"),
    ("ROS", {"angular_velocity.x", "header.stamp.secs"}, set(), "rad/s"),
    ("ROS", {"angular_velocity.x", "header.stamp.sec"}, set(), "rad/s"),
)

#: Names of the months in dates.
MONTHS = "Jan Feb Mar Apr May Jun Jul Aug Sep Oct Nov Dec".split()

#: The axis at the end of a name, after or before what it is an axis of, and axes of words.
AXES = re.compile(
    r"(w|g|gf|gyro|gyr|gy|omega|om|rot|rate|angvel|av|as|a|f|m|acc|ac|accel|mag|ang|angle|q|quat|r|p|t|v|b|d|e|)([xyzw])(\d*)"
    r"|([xyz])(gyro|gyr|acc|accel|mag|angvel|rate)"
)
SPOKEN = {"roll": "x", "pitch": "y", "yaw": "z", "beta": "x", "gamma": "y", "alpha": "z"}
#: Elements of quaternions by other names, after a word that says that it is one.
QUATERNION = {"i": "x", "j": "y", "k": "z", "real": "w", "scalar": "w"}

#: Fields that are no value.
MISSING = frozenset(
    ("", *"nan null none na n/a - -- nil ? (null) #n/a #value! #div/0! #ref! #num! #null!".split())
    + tuple(f"{sign}{word}" for sign in ("", "-") for word in ("1.#ind", "1.#qnan", "1.#inf", "nan(ind)"))
)
#: Dates and times of day; with one colon, minutes and seconds.
MOMENT = re.compile(
    r"(?:(?P<y>\d{4})[-/.](?P<m>\d\d?)[-/.](?P<d>\d\d?)"
    r"|(?P<a>\d\d?)(?:[-/.](?P<b>\d\d?)|[-/. ](?P<month>[A-Z][a-z]{2}))[-/. ](?P<y2>\d{4}|(?<=[./])\d\d)"
    r"|(?P<days>\d+) days?)?[T ,_]*"
    r"(?P<clock>\d{1,3}(?::\d\d){1,2})(?:[.,:](?P<f>\d{1,12}))?"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>Z|UTC|[+-]\d\d(:?\d\d)?)?"
)
