"""The command ``rasterslice``, and ``python -m rasterslice``: a process of our own."""

import sys

from . import lazily

lazily.begin()

from .cli import main  # noqa: E402  # after what makes its imports quick

if __name__ == "__main__":
    sys.exit(main())
