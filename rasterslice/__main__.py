"""The command ``rasterslice``, and ``python -m rasterslice``: a process of our own."""

import gc
import sys

gc.set_threshold(400_000)  # looking through all that is imported, again and again, finds no garbage

from . import lazily  # noqa: E402

lazily.begin()

from .cli import main  # noqa: E402  # after what makes its imports quick

if __name__ == "__main__":
    sys.exit(main())
