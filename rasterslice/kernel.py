"""A kernel and its arguments."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class Kernel(NamedTuple):
    """A kernel, and which of its arguments are buffers, numbers with their types, and bytes as they are."""

    kernel: Any
    buffers: list[int]
    numbers: list[tuple[int, bytes]]
    raw: list[int]

    @classmethod
    def called_with(cls, kernel: Any, args: tuple[Any, ...]) -> Kernel:
        """Return a kernel that takes arguments like these: int is int32 there, float float32, a tuple a vector."""
        kinds = {i: b"i" if isinstance(a, int) else b"f" for i, a in enumerate(args) if isinstance(a, (int, float))}
        raw = [i for i, a in enumerate(args) if isinstance(a, (tuple, np.ndarray))]
        buffers = [i for i in range(len(args)) if i not in kinds and i not in raw]
        return cls(kernel, buffers, list(kinds.items()), raw)

    def set_args(self, args: tuple[Any, ...]) -> None:
        """Set all arguments; their kinds are those of the first time."""
        self.kernel._set_arg_multi(tuple(x for i in self.buffers for x in (i, args[i])))
        self.kernel._set_arg_buf_pack_multi(tuple(x for i, kind in self.numbers for x in (i, kind, args[i])))
        if self.raw:
            values = [np.array(args[i], np.int32) if type(args[i]) is tuple else args[i] for i in self.raw]
            self.kernel._set_arg_buf_multi(tuple(x for pair in zip(self.raw, values, strict=True) for x in pair))
