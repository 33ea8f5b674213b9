"""Makes a screenshot small: three fifths of its size, and 128 colours.

usage: shrink.py PICTURE PNG
"""

import sys

from PIL import Image

picture = Image.open(sys.argv[1]).convert("RGB")
small = picture.resize([side * 3 // 5 for side in picture.size], Image.Resampling.LANCZOS)
small = small.quantize(128, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
small.save(sys.argv[2], optimize=True)
