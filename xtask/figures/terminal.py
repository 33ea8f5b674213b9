"""Draws what a terminal shows (`tmux capture-pane -e`) as SVG.

usage: terminal.py CAPTURE SVG
"""

import re
import sys
from html import escape
from pathlib import Path

capture, svg = Path(sys.argv[1]), Path(sys.argv[2])
WIDTH, HEIGHT, INK, PAPER = 7.8, 16, "#d8dee9", "#1d232b"
COLORS = ["#1d232b", "#e06c75", "#98c379", "#e5c07b", "#61afef", "#c678dd", "#56b6c2", "#d8dee9"]
BRIGHT = ["#7a8699", *COLORS[1:7], "#ffffff"]


class Pen:
    """Colours and weight, as the escape sequences set them."""

    def __init__(self):
        self.ink, self.paper, self.bold, self.swapped = None, None, False, False

    def take(self, codes):
        codes = [int(code or 0) for code in codes.split(";")]
        while codes:
            code = codes.pop(0)
            if code == 0:
                self.__init__()
            elif code in (1, 22):
                self.bold = code == 1
            elif code in (7, 27):
                self.swapped = code == 7
            elif code in (38, 48) and codes[:1] == [5]:
                number = codes[1] % 16
                self.set(code == 38, (COLORS + BRIGHT)[number])
                del codes[:2]
            elif 30 <= code <= 37 or 90 <= code <= 97:
                self.ink = (COLORS if code < 90 else BRIGHT)[code % 10]
            elif 40 <= code <= 47 or 100 <= code <= 107:
                self.paper = (COLORS if code < 100 else BRIGHT)[code % 10]
            elif code in (39, 49):
                self.set(code == 39, None)

    def set(self, is_ink, color):
        if is_ink:
            self.ink = color
        else:
            self.paper = color

    def colors(self):
        pair = self.ink or INK, self.paper or PAPER
        return pair[::-1] if self.swapped else pair


lines = capture.read_text().rstrip("\n").split("\n")
columns = max(len(re.sub(r"\x1b\[[0-9;]*m", "", line)) for line in lines)
width, height = columns * WIDTH + 16, len(lines) * HEIGHT + 16
out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height}" '
       f'font-family="DejaVu Sans Mono, Menlo, Consolas, monospace" font-size="13">',
       f'<rect width="100%" height="100%" rx="6" fill="{PAPER}"/>']
pen = Pen()
for row, line in enumerate(lines):
    column = 0
    y = 8 + row * HEIGHT
    for part in re.split(r"(\x1b\[[0-9;]*m)", line):
        if part.startswith("\x1b"):
            pen.take(part[2:-1])
            continue
        ink, paper = pen.colors()
        x, length = 8 + column * WIDTH, len(part) * WIDTH
        if part and paper != PAPER:
            out.append(f'<rect x="{x:.1f}" y="{y}" width="{length:.1f}" height="{HEIGHT}" fill="{paper}"/>')
        # Each run of words has its own place, whatever the font.
        for words in re.finditer(r"\S+(?: \S+)*", part):
            at = x + words.start() * WIDTH
            bold = ' font-weight="bold"' if pen.bold else ""
            out.append(f'<text x="{at:.1f}" y="{y + 12}" textLength="{len(words[0]) * WIDTH:.1f}" '
                       f'fill="{ink}"{bold}>{escape(words[0])}</text>')
        column += len(part)
out.append("</svg>")
svg.write_text("\n".join(out) + "\n")
