"""Animates how the trigger moves onto the phone's frames, from the tables of a data set.

alignment.py DATASET OUT.svg: each step is a pair of frames of `phone_frames.csv` and
`depth_frames.csv`; between them the flashes slide at the trigger's own pace.
"""

import csv
import statistics
import sys

STEPS = 28
FLASHES, PITCH_MS, FLASH_MS = 9, 1.575, 0.125  # the Azure Kinect's narrow modes
SECONDS = 9
LEFT, RIGHT, TOP, BOTTOM = 40, 570, 70, 250
FROM_MS, TO_MS = -20.0, 20.0
BARS, BARS_END = 640, 870


def table(path):
    with open(path, newline="") as file:
        names, *rows = csv.reader(file)
    names = [name.split(" ")[0].lstrip("#") for name in names]
    return [dict(zip(names, row)) for row in rows]


def differences(folder):
    """Depth minus phone of each phone frame in ms, followed through the slide."""
    phone = table(f"{folder}/phone_frames.csv")
    depth = [int(row["timestamp"]) for row in table(f"{folder}/depth_frames.csv") if row["timestamp"]]
    period = statistics.median(b - a for a, b in zip(depth, depth[1:]))
    found, at = [], 0
    for frame in phone:
        middle = int(frame["timestamp"])
        while at + 1 < len(depth) and abs(depth[at + 1] - middle) < abs(depth[at] - middle):
            at += 1
        found.append((depth[at] - middle) % period)
    # Whole periods, so that it ends near zero and never jumps.
    found.reverse()
    for i, value in enumerate(found):
        near = found[i - 1] if i else 0.0
        found[i] = value + round((near - value) / period) * period
    found.reverse()
    return [value / 1e6 for value in found], phone[0], period / 1e6


def main(folder, out):
    values, frame, period = differences(folder)
    start, middle = int(frame["start_of_exposure"]), int(frame["timestamp"])
    row_ms = int(frame["row_time"]) / 1e6
    arrived = next(i for i in range(len(values)) if all(abs(v) < 0.05 for v in values[i : i + 30]))
    moves = max(i for i in range(arrived) if abs(values[i] - values[0]) < 0.2)
    shown = [moves + round(i * (arrived - moves) / (STEPS - 1)) for i in range(STEPS)]
    times = [0.12 + 0.5 * i / (STEPS - 1) for i in range(STEPS)]
    after = values[arrived + 30 :]
    rows = round((2 * (middle - start) / 1e6 - 0.5) / row_ms)  # of 0.5 ms of exposure

    scale = (RIGHT - LEFT) / (TO_MS - FROM_MS)
    x = lambda ms: LEFT + (ms - FROM_MS) * scale
    keys = ";".join(["0"] + [f"{t:.3f}" for t in times] + ["0.7", "1"])

    def animate(attribute, steps, values=None):
        values = [steps[0], *steps, steps[-1], steps[-1]]
        text = ";".join(f"{v:.1f}" for v in values)
        return (f'<animate attributeName="{attribute}" dur="{SECONDS}s" repeatCount="indefinite" '
                f'keyTimes="{keys}" values="{text}"/>')

    lines = [
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 900 330" font-family="sans-serif" font-size="15">',
        "<title>The trigger moves the depth camera's flashes onto the phone's rows (simulated)</title>",
        '<rect width="900" height="330" rx="10" fill="#fff"/>',
        '<g fill="#223344">'
        f'<text x="{LEFT}" y="30" font-weight="bold">One frame of each camera</text>'
        f'<text x="{LEFT}" y="52" font-size="13"><tspan fill="#2b6ca3">phone: its rows expose one after '
        'another</tspan> <tspan dx="14" fill="#c4550f">depth camera: nine infrared flashes</tspan></text>'
        f'<text x="{BARS}" y="30" font-weight="bold">Pairs of the last two seconds</text>'
        f'<text x="{BARS}" y="52" font-size="13">depth − phone</text></g>',
        f'<clipPath id="c"><rect x="{LEFT}" y="{TOP}" width="{RIGHT - LEFT}" height="{BOTTOM - TOP}"/></clipPath>',
        f'<rect x="{LEFT}" y="{TOP}" width="{RIGHT - LEFT}" height="{BOTTOM - TOP}" fill="#f5f7fa" stroke="#99a"/>',
        '<g clip-path="url(#c)">',
    ]
    half, exposure = rows * row_ms / 2, 0.5
    corners = [(-half - exposure / 2, TOP + 12), (-half + exposure / 2, TOP + 12),
               (half + exposure / 2, BOTTOM - 12), (half - exposure / 2, BOTTOM - 12)]
    points = " ".join(f"{x(ms):.1f},{y}" for ms, y in corners)
    lines.append(f'<polygon points="{points}" fill="#2b6ca3"/>')
    lines.append('<g fill="#ee7722" fill-opacity="0.75">')
    slide = [values[i] * scale for i in shown]
    text = ";".join(f"{v:.1f}" for v in [slide[0], *slide, 0, 0])
    lines.append(f'<animateTransform attributeName="transform" type="translate" dur="{SECONDS}s" '
                 f'repeatCount="indefinite" keyTimes="{keys}" values="{text}"/>')
    for train in (-1, 0, 1):
        for flash in range(FLASHES):
            at = train * period + (flash - FLASHES // 2) * PITCH_MS - FLASH_MS / 2
            lines.append(f'<rect x="{x(at):.1f}" y="{TOP}" width="{max(FLASH_MS * scale, 2.5):.1f}" '
                         f'height="{BOTTOM - TOP}"/>')
    lines.append("</g></g>")
    for ms in range(-20, 21, 10):
        lines.append(f'<text x="{x(ms):.0f}" y="{BOTTOM + 20}" font-size="13" text-anchor="middle" fill="#556">{ms} ms</text>')

    # The histogram: bars of 1 ms.
    low, high = -18, 3
    if values[0] > 0:
        low, high = -3, 18
    width = (BARS_END - BARS) / (high - low)
    for bin in range(low, high):
        share = []
        for i in shown:
            window = values[max(0, i - 60) : i + 1]
            share.append(sum(bin - 0.5 <= v < bin + 0.5 for v in window) / len(window))
        final = [*share, 1.0 if bin == 0 else 0.0]
        if not any(final):
            continue
        tall = [f * (BOTTOM - TOP) for f in final]
        top = [BOTTOM - t for t in tall]
        left = BARS + (bin - low) * width

        def settled(steps):
            text = ";".join(f"{v:.0f}" for v in [steps[0], *steps[:-1], steps[-1], steps[-1]])
            return text

        lines.append(
            f'<rect x="{left:.1f}" y="{top[-1]:.0f}" width="{width - 1:.1f}" height="{tall[-1]:.0f}" fill="#ee7722">'
            f'<animate attributeName="y" dur="{SECONDS}s" repeatCount="indefinite" keyTimes="{keys}" values="{settled(top)}"/>'
            f'<animate attributeName="height" dur="{SECONDS}s" repeatCount="indefinite" keyTimes="{keys}" values="{settled(tall)}"/>'
            "</rect>")
    lines.append(f'<path d="M{BARS} {BOTTOM} H{BARS_END}" stroke="#99a"/>')
    for ms in (low + 3, 0) if low < -5 else (0, high - 3):
        lines.append(f'<text x="{BARS + (ms - low + 0.5) * width:.0f}" y="{BOTTOM + 20}" font-size="13" text-anchor="middle" fill="#556">{ms} ms</text>')

    # What the numbers are, step by step and then at rest.
    after_us = sorted(abs(v) * 1000 for v in after)
    rest = f"aligned: 95 % of {len(after)} pairs within {after_us[int(len(after) * 0.95)]:.0f} µs"
    labels = [f"moving: depth − phone {values[i]:+.1f} ms".replace("-", "−") for i in shown]
    starts = [0, *times[1:], 0.7]
    for i, label in enumerate([*labels, rest]):
        end = starts[i + 1] if i + 1 < len(starts) else 1
        marks, shows = [0.0], ["inline" if i == 0 else "none"]
        if i:
            marks.append(starts[i]); shows.append("inline")
        if end < 1:
            marks.append(end); shows.append("none")
        still = "inline" if label == rest else "none"
        lines.append(
            f'<text x="{LEFT}" y="305" font-size="17" fill="#223344" display="{still}">{label}'
            f'<animate attributeName="display" dur="{SECONDS}s" repeatCount="indefinite" calcMode="discrete" '
            f'keyTimes="{";".join(f"{m:.3f}" for m in marks)}" values="{";".join(shows)}"/></text>')
    lines.append(f'<text x="{BARS_END}" y="305" font-size="13" text-anchor="end" fill="#556">'
                 f'simulated; the move took {(shown[-1] - shown[0]) / 30:.1f} s</text>')
    lines.append("</svg>")
    with open(out, "w") as file:
        file.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
