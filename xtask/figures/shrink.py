"""Makes a screenshot small: three quarters of its size, and 48 colours.

usage: shrink.py PICTURE PNG
"""

import sys

from PIL import Image

picture = Image.open(sys.argv[1]).convert("RGB")
small = picture.resize([side * 3 // 4 for side in picture.size], Image.Resampling.LANCZOS)
small.quantize(48, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(sys.argv[2], optimize=True)
