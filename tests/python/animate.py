"""Pictures of one size as one animation: a PNG with a palette, of which each picture holds only what has changed.

Usage: animate.py FOLDER OUT.png [MILLISECONDS [COLOURS]]
"""

import pathlib
import sys

from PIL import Image

# How long the last picture stands, in pictures.
REST = 12


def main(folder: str, out: str, milliseconds: str = "120", colours: str = "96") -> None:
    """Writes the animation."""
    paths = sorted(pathlib.Path(folder).glob("*.png"))
    pictures = [Image.open(path).convert("RGB") for path in paths]
    if not pictures:
        sys.exit(f"{folder}: no pictures")
    # One palette for all: of a strip of pictures from the whole flight.
    chosen = pictures[:: max(1, len(pictures) // 8)]
    width, height = pictures[0].size
    strip = Image.new("RGB", (width, height * len(chosen)))
    for n, picture in enumerate(chosen):
        strip.paste(picture, (0, n * height))
    palette = strip.quantize(int(colours), dither=Image.Dither.NONE)
    flat = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    step = int(milliseconds)
    durations = [step] * (len(flat) - 1) + [step * REST]
    flat[0].save(out, save_all=True, append_images=flat[1:], duration=durations, loop=0, optimize=True)
    size = pathlib.Path(out).stat().st_size
    print(f"{out}: {len(flat)} pictures, {size} bytes")


if __name__ == "__main__":
    main(*sys.argv[1:])
